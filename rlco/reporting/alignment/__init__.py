"""How much of what sim teaches holds for the robot: a page, and the map beside it."""
