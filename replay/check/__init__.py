"""A recording against today's code: steps run again, differences named, and why a robot believed what it believed."""
