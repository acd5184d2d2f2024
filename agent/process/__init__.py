"""What runs an agent: its loop, links to neighbours, keys, certificates, terminal, and the start of processes."""
