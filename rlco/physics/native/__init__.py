"""N worlds of one model stepped in threads, without robosuite's Python."""
