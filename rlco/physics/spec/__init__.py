"""The simulated system as data: tasks, domains, observations, controllers."""
