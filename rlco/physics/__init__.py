"""Scenes, experts, control and stepping of robosuite models, without torch."""
