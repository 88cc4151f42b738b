"""What the robot practises next."""
