"""Rollouts of the simulator, ready for the learner."""

from rlco.collectors.advantages import check_signal as check_signal
from rlco.collectors.advantages import group_advantages as group_advantages
from rlco.collectors.from_options import make_collector as make_collector
from rlco.collectors.rollouts import RolloutCollector as RolloutCollector
