"""What a robot can do beside measuring targets, a folder each: swim, light, survey."""
