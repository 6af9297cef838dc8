"""TorchRL parts and recipes for RL-based sim-real co-training of robot policies.

Nothing is imported here, so that what needs no torch stays fast: import from
``rlco.losses``, ``rlco.envs``, ``rlco.data``, ``rlco.policies``, ``rlco.run``.
"""

__version__ = "0.1.0"
