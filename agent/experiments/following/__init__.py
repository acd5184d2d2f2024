"""How well robots follow a target that swims: moored, alone, silent, or sharing what they see."""
