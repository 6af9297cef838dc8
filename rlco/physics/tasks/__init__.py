"""rlco's own tasks: scenes, rewards, scripted experts; and tasks by name."""
