"""Rollouts of the simulator, ready for the learner."""

from rlco.collectors.rollouts import RolloutCollector as RolloutCollector
