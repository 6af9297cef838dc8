"""Demonstrations (LeRobot data sets <-> TensorDict) and the sim-real mix."""

from __future__ import annotations

from rlco.data.augment import Augmentation as Augmentation
from rlco.data.demos import DemoMeta as DemoMeta
from rlco.data.demos import DemoReplayBuffer as DemoReplayBuffer
from rlco.data.demos import load_demos as load_demos
from rlco.data.expert_demos import record_demonstrations as record_demonstrations
from rlco.data.expert_demos import record_once as record_once
from rlco.data.filming import film_demonstrations as film_demonstrations
from rlco.data.instructions import InstructionText as InstructionText
from rlco.data.quantiles import exact_quantiles as exact_quantiles
from rlco.data.recording import DemoWriter as DemoWriter
from rlco.data.sim_real_buffer import SimRealReplayBuffer as SimRealReplayBuffer
from rlco.data.task_demos import load_task_demos as load_task_demos
