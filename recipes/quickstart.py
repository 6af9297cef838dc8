"""The whole chain in one command: record, imitate, reinforce, compare, report.

    uv run recipes/quickstart.py
    uv run recipes/quickstart.py image=dense    # from images alone, without poses
    uv run recipes/quickstart.py train_domain=gap_report/effects.yaml

Demonstrations are recorded in the simulator and in ``stand_in``, a second simulator
that plays the robot's part; no robot moves. Then four policies are trained and
compared in both: real_only (Stage I on real demonstrations only), sft (Stage I on
both), rl_only (sft, then PPO in the simulator) and rl_co (the same PPO, anchored to the
real demonstrations).
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlco.errors import RenderingError, UnknownNameError
from rlco.run import Run, run_recipe
from rlco.training.options.policy_options import (
    AugmentOptions,
    PolicyOptions,
    camera_list,
    group_values,
)
from rlco.training.options.pretraining_options import PretrainingOptions
from rlco.training.options.quickstart_options import METHODS
from rlco.training.options.quickstart_options import QuickstartOptions as Config
from rlco.training.options.stage_one_options import StageOneOptions
from rlco.training.options.stage_two_options import StageTwoOptions

if TYPE_CHECKING:
    from rlco.physics.spec.domain import Domain
    from rlco.policies import ChunkPolicy
    from rlco.reporting.statistics import ResultRow

log = logging.getLogger("rlco.quickstart")
#: Options that mean the same in both stages, beside those of `PolicyOptions`.
SHARED = ["seed", "threads", "keep_checkpoints", "task", "eval_domains", "effects_code"]


# -- Options of the stages ---------------------------------------------------------


def stage_one(config: Config, demos: dict[str, str], method: str) -> StageOneOptions:
    """Return the options of a run of Stage I."""
    # Scenes are simulated, and real_only is to know nothing of a simulator.
    scenes = {} if method == "real_only" else group_values(config, PretrainingOptions)
    if scenes and config.pretrain_scenes:
        scenes["pretrain_domain"] = config.train_domain
    elif scenes:
        del scenes["pretrain_passes"]  # image=dense implies some
    return StageOneOptions(
        name=method,
        sim_demos=demos["sim"],
        real_demos=demos["real"],
        sim_ratio=0.0 if method == "real_only" else config.sim_ratio,
        updates=config.updates,
        **scenes,
        **{name: getattr(config, name) for name in SHARED},
        **group_values(config, PolicyOptions),
    )


def stage_two(
    config: Config, folder: Path, demos: dict[str, str], method: str
) -> StageTwoOptions:
    """Return the options of a run of Stage II inside a run directory."""
    return StageTwoOptions(
        name=method,
        policy=str(folder / "stages" / "sft" / "policy"),
        real_demos=demos["real"],
        heldout_demos=demos["heldout"],
        real_coeff=0.0 if method == "rl_only" else config.real_coeff,
        iterations=config.iterations,
        num_envs=config.num_envs,
        horizon=config.horizon,
        advantage=config.advantage,
        eval_every=config.eval_every,
        eval_episodes=config.curve_episodes,
        train_domain=config.train_domain,
        train_sample=config.train_sample,
        image_fixed=config.image_fixed,
        lr=config.rl_lr,
        **{name: getattr(config, name) for name in SHARED},
        **group_values(config, AugmentOptions),
    )


def check(config: Config) -> tuple[dict[str, Domain], dict[str, Domain]]:
    """Check all options; return the domains of the curves, and all to compare in."""
    from rlco.evaluation import evaluation_domains
    from rlco.physics.effects import load_code
    from rlco.physics.tasks.make_task import make_task
    from rlco.physics.tasks.named_task import check_domains
    from rlco.training.stage_one import check_stage_one
    from rlco.training.stage_two import check_stage_two

    for method in config.methods:
        if method not in METHODS:
            raise UnknownNameError("method", method, METHODS)
    make_task(config.task)
    load_code(config.effects_code)
    domains = evaluation_domains(
        config.task,
        config.eval_domains,
        train_domain=config.train_domain,
        train_sample=config.train_sample,
    )
    check_domains(config.task, [config.real_domain])
    further = evaluation_domains(config.task, config.final_domains)
    nowhere = {"sim": "", "real": "", "heldout": ""}
    check_stage_two(stage_two(config, Path(), nowhere, "rl_co"))
    check_stage_one(stage_one(config, nowhere, "sft"))
    return domains, domains | further


# -- Record, imitate, reinforce, compare -------------------------------------------


def record(config: Config, folder: Path) -> dict[str, str]:
    """Record the data sets that do not exist yet; return their folders."""
    from rlco.data import record_once

    plan = {
        "sim": (config.train_domain, config.sim_demos, 3 * config.seed),
        "real": (config.real_domain, config.real_demos, 3 * config.seed + 1),
        "heldout": (config.real_domain, config.heldout_demos, 3 * config.seed + 2),
    }
    cameras = camera_list(config.camera)
    camera = cameras if len(cameras) > 1 else config.camera
    for name, (domain, episodes, seed) in plan.items():
        record_once(
            folder / name,
            config.task,
            domain,
            episodes=episodes,
            camera=camera if config.reads_images else None,
            image_size=config.image_size if config.reads_images else None,
            renderer=config.renderer,
            seed=500_000 + seed,  # far from the seeds of rollouts and evaluations
        )
    return {name: str(folder / name) for name in plan}


def imitate(config: Config, run: Run, demos: dict[str, str], method: str) -> Any:
    """Return a policy of Stage I."""
    from rlco.training.stage_one import load_stage_one, train_stage_one

    folder = f"stages/{method}"
    options = run.stage_options(
        stage_one(config, demos, method), folder, anew=("sim_demos", "real_demos")
    )
    data = load_stage_one(options)
    with run.stage(options, "sft", folder) as stage:
        return train_stage_one(options, stage, data)


def reinforce(
    config: Config,
    run: Run,
    demos: dict[str, str],
    method: str,
    domains: dict[str, Domain],
) -> ChunkPolicy:
    """Return a policy of Stage II, trained as rl_co.py trains it."""
    from rlco.collectors import check_signal, make_collector
    from rlco.evaluation import evaluation_envs, read_by, success_rates
    from rlco.losses import CoTrainingLoss, ImitationLoss
    from rlco.policies import save_policy
    from rlco.training.held_out import HeldOut
    from rlco.training.iterations import co_train
    from rlco.training.stage_two import (
        fix_pose_range,
        load_stage_two,
        make_critic,
        make_learner,
        make_ppo,
        rollout_rows,
    )

    folder = f"stages/{method}"
    options = run.stage_options(
        stage_two(config, run.path, demos, method),
        folder,
        anew=("policy", "real_demos", "heldout_demos"),
    )
    policy, data = load_stage_two(options)
    with run.stage(options, "rl_co", folder) as stage:
        critic = make_critic(options, policy)
        real = data.real if options.real_coeff > 0 else None
        loss = CoTrainingLoss(
            make_ppo(policy, critic, clip=options.clip),
            None if real is None else ImitationLoss(policy),
            real_coeff=options.real_coeff,
        )
        rows = rollout_rows(options, policy.chunk)
        learner = make_learner(options, loss, policy, critic, real, rows=rows)
        collector = make_collector(
            options,
            policy,
            critic,
            backend=options.backend,
            chunk=policy.chunk,
            image_size=policy.image_size,
            renderer=policy.renderer,
            cameras=policy.cameras,
            prepare=fix_pose_range(critic, policy) if stage.step is None else None,
        )
        episodes = options.eval_episodes
        envs = evaluation_envs(
            options.task,
            domains,
            chunk=policy.chunk,
            episodes=episodes,
            **read_by(policy),
        )
        held_out = HeldOut(policy, data.heldout)  # before a checkpoint is loaded
        if stage.step is None:
            before = success_rates(policy, envs, episodes, 0)
            before |= held_out.measure(policy)
            stage.log_metrics(0, {"frames": 0} | before)
        for iteration, row in co_train(
            options,
            stage,
            collector,
            learner,
            check_first=check_signal,
            measure=options.evaluates,
        ):
            row |= held_out.measure(policy)
            if options.evaluates(iteration):
                row |= success_rates(policy, envs, episodes, iteration)
        extra = {"real_coeff": options.real_coeff, **collector.env.task.description()}
        save_policy(policy, stage.path / "policy", extra=extra)
        collector.close()
    return policy


def train(
    config: Config, run: Run, demos: dict[str, str], domains: dict[str, Domain]
) -> dict[str, ChunkPolicy]:
    """Train every policy that the methods need; return them by method."""
    needed = set(config.methods)
    if needed & {"rl_only", "rl_co"}:
        needed.add("sft")
    (run.path / "stages").mkdir(exist_ok=True)
    policies = {}
    for method in METHODS:
        if method in needed and method in ("real_only", "sft"):
            policies[method] = imitate(config, run, demos, method)
        elif method in needed:
            policies[method] = reinforce(config, run, demos, method, domains)
    return {method: policies[method] for method in config.methods}


def compare(
    config: Config, policies: dict[str, ChunkPolicy], domains: dict[str, Domain]
) -> list[ResultRow]:
    """Evaluate every policy in every domain, from the same initial states.

    What the last method gains over the others is printed with its paired interval.
    """
    from rlco.evaluation import final_rows
    from rlco.reporting.differences import last_differences

    rows = []
    for name, domain in domains.items():
        for method, policy in policies.items():
            rows += final_rows(
                policy,
                {name: domain},
                config.eval_episodes,
                method=method,
                task=config.task,
                seed=config.seed,
            )
    for one in last_differences(rows):
        log.info("%s - %s in %s: %s", one.first, one.second, one.column[1], one)
    return rows


# -- Report ------------------------------------------------------------------------


def draw(config: Config, run: Run, rows: list[ResultRow], curves: list[str]) -> None:
    """Draw the figures of the report, with curves of these domains."""
    from rlco.reporting import image_plots, plots
    from rlco.reporting.stage_figures import draw_stages
    from rlco.videos import same_scene

    plots.save_figure(plots.success_bars(rows), run.plots / "success.png")
    draw_stages(
        {
            method: run.path / "stages" / method
            for method in ("rl_only", "rl_co")
            if method in config.methods
        },
        curves,
        run.plots,
        episodes=config.curve_episodes,
    )
    if config.reads_images:
        images = same_scene(
            config.task,
            (config.train_domain, config.real_domain),
            cameras=camera_list(config.camera),
            image_size=(config.image_size, config.image_size),
            renderer=config.renderer,
        )
        figure = image_plots.same_scene(images)
        plots.save_figure(figure, run.plots / "same_scene.png")


def film(config: Config, run: Run, method: str, policy: Any, domain: Domain) -> None:
    """Film an episode, and draw some of its frames for the report."""
    from rlco.reporting.plots import save_figure
    from rlco.videos import record_video

    path = run.videos / f"{method}_{domain.name}.mp4"
    try:
        filmed = record_video(policy, config.task, domain, path, chunk=policy.chunk)
    except RenderingError as error:
        log.warning("no frames in the report: %s", error)
        return
    save_figure(filmed.strip(domain.name, method), run.plots / "episode.png")


def notes(config: Config) -> list[str]:
    """Return what the report says of the options, below its headline."""
    said = []
    if config.train_domain != "sim":
        said.append(
            f"Simulated demonstrations and RL use the domain {config.train_domain}."
        )
    if config.reads_images and not config.use_environment_state:
        size, cameras = config.image_size, camera_list(config.camera)
        said.append(
            f"Policies read images of {' and '.join(cameras)}, {size} x {size} pixels, "
            "and the robot's own state; as they act, nothing tells them where objects "
            "are."
        )
    if config.reads_images and config.pretrain_scenes:
        said.append(
            "Before imitation their encoder learned where things are from "
            f"{config.pretrain_scenes} labelled scenes of {config.train_domain}; that "
            "of real_only, which is to know no simulator, had its demonstrations alone."
        )
    return said


def main(config: Config) -> None:
    """Run the chain, and write the report."""
    from rlco.reporting.report import write_report

    domains, final = check(config)
    with Run(config, "quickstart") as run:
        demos = record(config, run.path / "data")
        policies = train(config, run, demos, domains)
        rows = compare(config, policies, final)
        run.save_results(rows)
        draw(config, run, rows, list(domains))
        if config.film:
            method, policy = list(policies.items())[-1]
            film(config, run, method, policy, list(domains.values())[-1])
    report = write_report(run.path, notes=notes(config))
    log.info("report: %s", report)


if __name__ == "__main__":
    run_recipe(main, Config)
