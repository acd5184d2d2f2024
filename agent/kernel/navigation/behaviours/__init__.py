"""What a robot that swims can be told to do, as a reference for the pilot at every moment."""
