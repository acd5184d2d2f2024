"""What people order a robot to do: read, judged, carried out once, answered."""
