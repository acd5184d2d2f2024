"""What every robot has: messages, settings, inputs and outputs of a step, its transaction, the state of a target."""
