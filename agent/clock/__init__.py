"""What time it is, and waiting for it: the only folder that asks the machine's clock."""
