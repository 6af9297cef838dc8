"""What an experiment of many runs came to: tables and figures over seeds."""
