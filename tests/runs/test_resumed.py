"""A resumed run believes nothing: options, inputs and tables are as it left them."""

from __future__ import annotations

import json
import os
import resource
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from rlco.errors import CheckpointError, ConfigError, RlcoError
from rlco.run import Run, run_recipe
from rlco.runs import run_folder
from rlco.runs.config import RunOptions, option, parse
from rlco.runs.state_files import load_state, save_state


@dataclass
class Options(RunOptions):
    """Options of the runs below."""

    lr: float = option(0.5, "a number")
    demos: str | None = option(None, "a folder", input="folder")
    domains: list[str] = option(["sim"], "names or files", input="file")


@pytest.fixture
def demos(tmp_path: Path) -> Path:
    (tmp_path / "demos/data").mkdir(parents=True)
    (tmp_path / "demos/data/a.parquet").write_bytes(b"0123456789")
    return tmp_path / "demos"


@pytest.fixture
def out(tmp_path: Path, demos: Path) -> Path:
    """A run of two iterations, with a checkpoint after each."""
    options = Options(out=str(tmp_path / "run"), lr=0.25, demos=str(demos))
    with Run(options, "demo") as run:
        for step in run.iterations(2):
            run.log_metrics(step, {"loss": step / 4})
            run.save_checkpoint(step, {"weight": torch.ones(3)})
    return tmp_path / "run"


def resume(out: Path, *more: str) -> None:
    config = parse(Options, [f"resume={out}", *more], "demo.py")
    with Run(config, "demo") as run:
        assert run.load_checkpoint()["weight"].tolist() == [1, 1, 1]


@pytest.mark.parametrize("name", ["log.txt", "metrics.csv", "checkpoints"])
def test_a_run_is_not_resumed_out_of_its_folder(out: Path, name: str) -> None:
    outside = out.parent / "outside"
    (out / name).rename(outside)
    (out / name).symlink_to(outside)
    before = outside.read_bytes() if outside.is_file() else None
    with pytest.raises(RlcoError, match=f"'{name}' of run folder .* leads out of it"):
        resume(out)
    assert before is None or outside.read_bytes() == before


def test_a_link_within_a_run_is_followed(out: Path) -> None:
    (out / "metrics.csv").rename(out / "kept.csv")
    (out / "metrics.csv").symlink_to("kept.csv")
    resume(out)


def test_what_is_as_it_was_is_resumed(out: Path) -> None:
    before = (out / "metrics.csv").read_bytes()
    resume(out)
    resume(out, "threads=2")
    assert (out / "metrics.csv").read_bytes() == before
    options = json.loads((out / "run.json").read_text())["options"]
    assert (options["lr"], options["threads"]) == (0.25, 2)


def without(out: Path) -> None:
    (out / "metrics.csv").unlink()


def cut_at_a_row(out: Path) -> None:
    text = (out / "metrics.csv").read_text()
    (out / "metrics.csv").write_text("".join(text.splitlines(keepends=True)[:-1]))


def changed(out: Path) -> None:
    text = (out / "metrics.csv").read_text()
    (out / "metrics.csv").write_text(text.replace("0.25", "0.75"))


@pytest.mark.parametrize("damage", [without, cut_at_a_row, changed])
def test_a_table_that_is_not_what_the_run_wrote(out: Path, damage: object) -> None:
    damage(out)  # type: ignore[operator]
    with pytest.raises(CheckpointError, match=r"metrics\.csv' is not what it was when"):
        resume(out)


@pytest.mark.parametrize("text", ["step,loss\nx,1\n", "loss\n1\n", "step\n1,2\n\xff"])
def test_a_table_that_is_none(out: Path, text: str) -> None:
    (out / "metrics.csv").write_bytes(text.encode("latin-1"))
    with pytest.raises(RlcoError, match=r"metrics\.csv"):
        resume(out)


def test_options_cut_off_at_the_end_of_a_line(out: Path) -> None:
    lines = (out / "config.yaml").read_text().splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if line.startswith("lr"))
    (out / "config.yaml").write_text("".join(lines[:at]))
    with pytest.raises(RlcoError, match=r"started with lr=0\.25, .* has lr=0\.5"):
        resume(out)


def test_an_input_that_was_changed_in_place(out: Path, demos: Path) -> None:
    (demos / "data/a.parquet").write_bytes(b"0123456780")  # as long
    with pytest.raises(
        RlcoError, match=r"demos=.* is not what run .* was started with"
    ):
        resume(out)


def test_an_input_that_is_another_or_gone(out: Path, demos: Path) -> None:
    other = demos.rename(demos.with_name("moved"))
    with pytest.raises(RlcoError, match=r"content differs or is missing"):
        resume(out)
    resume(out, f"demos={other}")  # data may move
    resume(out)  # and is found there from then on
    (other / "more").write_text("")
    with pytest.raises(RlcoError, match=r"is not what run"):
        resume(out)


def test_a_module_of_ones_own_that_was_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_domain.py").write_text("HARD = 1\n")
    options = Options(out=str(tmp_path / "run"), domains=["sim", "my_domain:HARD"])
    with Run(options, "demo") as run:
        run.log_metrics(1, {"loss": 1.0})
        run.save_checkpoint(1, {"weight": torch.ones(3)})
    resume(tmp_path / "run")
    (tmp_path / "my_domain.py").write_text("HARD = 2\n")
    with pytest.raises(
        RlcoError, match=r"code of your own is not what run .*my_domain"
    ):
        resume(tmp_path / "run")


def test_a_name_is_no_input_and_a_file_is(tmp_path: Path) -> None:
    file = tmp_path / "gap.yaml"
    file.write_text("effects: []\n")
    options = Options(out=str(tmp_path / "run"), domains=["sim", str(file)])
    with Run(options, "demo"):
        pass
    file.write_text("effects: []\nnames: {}\n")
    with pytest.raises(RlcoError, match=r"domains=.* is not what run"):
        Run(replace(options, out=None, resume=str(tmp_path / "run")), "demo")


@pytest.mark.parametrize(
    "given", ["[stand_in,{moved}]", "[{moved},sim]", "[sim]", "[sim,{moved},{moved}]"]
)
def test_a_file_may_move_and_what_stands_beside_it_may_not(
    tmp_path: Path, given: str
) -> None:
    file, moved = tmp_path / "gap.yaml", tmp_path / "moved.yaml"
    file.write_text("effects: []\n")
    with Run(Options(out=str(tmp_path / "run"), domains=["sim", str(file)]), "demo"):
        pass
    file.rename(moved)
    resumed = [f"resume={tmp_path / 'run'}", "domains=" + given.format(moved=moved)]
    with pytest.raises(RlcoError, match=r"domains=.* is not what run"):
        Run(parse(Options, resumed, "demo.py"), "demo")
    resumed[1] = f"domains=[sim,{moved}]"
    with Run(parse(Options, resumed, "demo.py"), "demo"):
        pass


def test_a_name_cannot_become_another_one(tmp_path: Path) -> None:
    with Run(Options(out=str(tmp_path / "run")), "demo"):
        pass
    resumed = [f"resume={tmp_path / 'run'}", "domains=[stand_in]"]
    with pytest.raises(RlcoError, match=r"with domains=.*sim.*, and now has .*stand"):
        Run(parse(Options, resumed, "demo.py"), "demo")


def test_a_folder_with_the_name_of_a_domain_is_no_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sim").mkdir()
    with Run(Options(out="run"), "demo"):
        pass
    (tmp_path / "sim" / "more").write_text("")
    with Run(Options(resume="run"), "demo"):
        pass


def with_random_state(out: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the last checkpoint's random state; its checksum is of what is there."""
    path = out / "checkpoints" / "step_0000002.safetensors"
    saved = load_state(path)
    change(saved["rng"])
    save_state(path, saved)


@pytest.mark.parametrize(
    "change",
    [
        lambda rng: rng.clear(),
        lambda rng: rng.update(python=(3, (1, 2), None)),
        lambda rng: rng.update(numpy=[]),
        lambda rng: rng["numpy"]["state"].update(pos=10**6),
        lambda rng: rng["numpy"]["state"].update(key=np.zeros(5, np.uint32)),
        lambda rng: rng.update(torch=torch.zeros(3, dtype=torch.uint8)),
        lambda rng: rng.update(torch=None),
        lambda rng: rng.update(cuda=5),
        lambda rng: rng.update(cuda={}),
        lambda rng: rng.update(cuda=[torch.zeros(3, dtype=torch.uint8)]),
        lambda rng: rng.update(cuda=[5]),
    ],
)
def test_a_random_state_that_is_none(
    out: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    with_random_state(out, change)
    with pytest.raises(CheckpointError, match=r"random state of checkpoint .*step_"):
        resume(out)


def test_a_random_state_of_gpus_is_resumed_without_them(out: Path) -> None:
    gpu = torch.zeros(16, dtype=torch.uint8)
    with_random_state(out, lambda rng: rng.update(cuda=[gpu, gpu]))
    resume(out)


def test_a_link_with_the_name_of_what_is_half_written(out: Path) -> None:
    (out / ".a.part").symlink_to("checkpoints")
    resume(out)
    assert not (out / ".a.part").is_symlink()
    assert (out / "checkpoints" / "step_0000002.safetensors").is_file()


def test_runs_from_before_are_resumed(out: Path, demos: Path) -> None:
    info = json.loads((out / "run.json").read_text())
    del info["options"], info["inputs"]
    (out / "run.json").write_text(json.dumps(info))
    (demos / "data/a.parquet").write_bytes(b"another")
    resume(out)


@pytest.mark.parametrize(
    "text", ["{", "[1]", '{"recipe": 3}', "[" * 5000, "\xff", "{}"]
)
def test_a_run_json_that_is_none(out: Path, text: str) -> None:
    (out / "run.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(RlcoError, match=r"run\.json"):
        resume(out)


# -- Secrets ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "value",
    ["${oc.env:SECRET}", "x${oc.env:SECRET,none}y", "${oc.${name}:SECRET}", "${a:b}"],
)
def test_an_environment_variable_is_not_filled_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: str
) -> None:
    monkeypatch.setenv("SECRET", "hunter2")
    file = tmp_path / "foreign.yaml"
    for text in (f'demos: "{value}"\n', f'domains: ["{value}"]\n'):
        file.write_text(text)
        with pytest.raises(ConfigError, match="asks for more than another") as caught:
            parse(Options, [f"config={file}"], "demo.py")
        assert "hunter2" not in str(caught.value)
    with pytest.raises(ConfigError, match="asks for more than another"):
        parse(Options, [f"demos={value}"], "demo.py")


def test_another_option_is_filled_in() -> None:
    config = parse(Options, ["name=arm", "demos=demos/${name}"], "demo.py")
    assert config.demos == "demos/arm"


# -- Ends ------------------------------------------------------------------------------


def test_a_run_killed_while_it_is_made_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = Options(out=str(tmp_path / "run" / "stages" / "one"))

    def die(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", die)
        with pytest.raises(KeyboardInterrupt):
            Run(options, "demo")
    assert not Path(str(options.out)).exists()
    with Run(options, "demo"):
        pass


def test_a_stage_cut_off_at_its_start_begins_anew(tmp_path: Path) -> None:
    with Run(Options(out=str(tmp_path / "run")), "demo"):
        pass
    left = tmp_path / "run" / ".stage.4321.part"  # as a kill leaves it
    left.mkdir()
    (left / "config.yaml").write_text("lr: 0.5\n")
    with Run(Options(resume=str(tmp_path / "run")), "demo") as run:
        assert not left.exists()
        with run.stage(Options(lr=0.75), "inner", "stage") as stage:
            assert not stage.resumed


@pytest.fixture
def as_found() -> Iterator[None]:
    """Put signals and limits back."""
    numbers = (signal.SIGTERM, signal.SIGHUP)
    handlers = [signal.signal(number, signal.SIG_DFL) for number in numbers]
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    for number, handler in zip(numbers, handlers, strict=True):
        signal.signal(number, handler)


@pytest.mark.usefixtures("as_found")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_run_as_ctrl_c_does(tmp_path: Path, number: int) -> None:
    def main(config: Options) -> None:
        with Run(config, "demo") as run:
            for step in run.iterations(5):
                run.log_metrics(step, {"loss": 1.0})
                run.save_checkpoint(step, {"weight": torch.ones(3)})
                if step == 2:
                    os.kill(os.getpid(), number)

    with pytest.raises(SystemExit) as caught:
        run_recipe(main, Options, [f"out={tmp_path / 'run'}"])
    assert caught.value.code == 128 + number
    info = json.loads((tmp_path / "run" / "run.json").read_text())
    assert info["status"] == "interrupted"
    resume(tmp_path / "run")


@pytest.mark.usefixtures("as_found")
def test_a_full_disk_is_one_sentence_and_loses_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The system refuses to write more than so many bytes, at a checkpoint."""

    def main(config: Options) -> None:
        with Run(config, "demo") as run:
            for step in run.iterations(5):
                run.log_metrics(step, {"loss": 1.0})
                size = 3 if step < 3 else 300_000
                run.save_checkpoint(step, {"weight": torch.ones(size)})

    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, hard))
    with pytest.raises(SystemExit) as caught:
        run_recipe(main, Options, [f"out={tmp_path / 'run'}"])
    resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    assert caught.value.code == 1
    said = capsys.readouterr().err
    assert "cannot be written or read (File too large); make room" in said
    assert "Traceback" not in said
    assert json.loads((tmp_path / "run" / "run.json").read_text())["status"] == "failed"
    resume(tmp_path / "run")


@pytest.mark.usefixtures("as_found")
def test_a_read_only_folder_is_one_sentence(
    out: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, _text: str) -> None:
        raise OSError(30, "Read-only file system", str(path))

    def main(config: Options) -> None:
        with Run(config, "demo"):
            pass

    monkeypatch.setattr(run_folder, "write_text", refuse)
    with pytest.raises(SystemExit) as caught:
        run_recipe(main, Options, [f"out={out.with_name('new')}"])
    assert caught.value.code == 2  # none was begun: another out= is all it takes
    assert "cannot be made (Read-only file system)" in capsys.readouterr().err
