"""An experiment as its YAML file says it, and what is wrong in one."""
