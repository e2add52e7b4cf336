"""What exists in a scene and how a Time-of-Flight camera sees it: bodies, cabins, sensors, contact."""
