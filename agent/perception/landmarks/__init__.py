"""What a robot finds itself by: tags at surveyed places, and points that stay where they are."""
