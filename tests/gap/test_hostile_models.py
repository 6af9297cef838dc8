"""Models made to fill a memory: compiled elsewhere, within limits."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rlco.errors import RlcoError
from rlco.gap import trial
from rlco.gap.declared import check_text
from rlco.gap.model import load_model

BODY = "<body><joint name='j'/><geom size='1'/></body>"
FIELD = (
    "<mujoco><asset><hfield name='h' nrow='100000' ncol='100000' size='1 1 1 1'/>"
    f"</asset><worldbody><geom type='hfield' hfield='h'/>{BODY}</worldbody></mujoco>"
)
COPIES = (
    "<mujoco><worldbody><replicate count='100000000' offset='1 0 0'>"
    f"{BODY}</replicate></worldbody></mujoco>"
)


def test_a_model_of_a_few_words_that_fills_a_memory(tmp_path: Path) -> None:
    file = tmp_path / "model.xml"
    file.write_text(FIELD)
    with pytest.raises(RlcoError, match=r"takes more than 2.0 GB or 10 s to compile"):
        load_model(file)


def test_a_model_that_compiles_for_hours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that says nothing of it in its text: its time is limited."""
    monkeypatch.setattr(trial, "SECONDS", 1.0)
    monkeypatch.setattr("rlco.gap.declared.MOST", 10**12)
    file = tmp_path / "model.xml"
    file.write_text(COPIES)
    with pytest.raises(RlcoError, match=r"takes more than 2.0 GB or 1 s to compile"):
        load_model(file)


MANY = "<replicate count='101'><replicate count='0x64'>{}</replicate></replicate>"


@pytest.mark.parametrize(
    "inside",
    [
        "<replicate count='100000000'><geom size='1'/></replicate>",
        "<replicate count='&#49;00000000'><geom size='1'/></replicate>",
        "<body><replicate sep='>' count='20000x'><geom size='1'/></replicate></body>",
        MANY.format("<geom size='1'/>"),
        MANY.format("<!-- > --><include file='more.xml'/>"),
        "<replicate count='200'><flexcomp count='10 10 1'/></replicate>"
        "<replicate count='200'><composite count='10 10 1'><geom/></composite>"
        "</replicate>",
        "<replicate count='999999999999999999999999'><geom/></replicate>",
    ],
)
def test_replicates_are_counted_before_anything_is_compiled(
    tmp_path: Path, inside: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def compiled(*_: object) -> None:
        raise AssertionError("it was tried")

    monkeypatch.setattr("rlco.gap.model.try_model", compiled)
    more = "<mujocoinclude><geom size='1'/><geom size='2'/></mujocoinclude>"
    (tmp_path / "more.xml").write_text(more)
    file = tmp_path / "model.xml"
    file.write_text(f"<mujoco><worldbody>{inside}</worldbody></mujoco>")
    with pytest.raises(RlcoError, match=r"makes \d+ elements of \d+ by replicate"):
        load_model(file)


def test_a_large_model_and_a_comment_replicate_nothing(tmp_path: Path) -> None:
    geoms = "<geom size='1'/>" * 20_000
    said = "<!-- <replicate count='100000000'><geom/></replicate> -->"
    some = "<replicate count='9000'><geom/></replicate><replicate count='900'/>"
    check_text(tmp_path / "a.xml", f"<mujoco>{said}{geoms}{some}</mujoco>")
    with pytest.raises(RlcoError, match="makes 20003 elements"):
        check_text(tmp_path / "a.xml", "<a><replicate count='20001'><b/></a>")


# -- Options ----------------------------------------------------------------------


@pytest.mark.parametrize(
    "option",
    [
        "timestep='0'",
        "timestep='-1'",
        "timestep='1e-12'",
        "timestep='1e6'",
        "timestep='nan'",
        "gravity='0 nan 0'",
        "gravity='0 0 1e300'",
        "iterations='2000000000' tolerance='0'",
        "density='-1'",
        "o_solref='nan 1'",
    ],
)
def test_options_that_cannot_be_simulated(tmp_path: Path, option: str) -> None:
    text = f"<mujoco><option {option}/><worldbody>{BODY}</worldbody></mujoco>"
    (tmp_path / "model.xml").write_text(text)
    name = option.partition("=")[0]
    said = rf"the option {name} of model .*model\.xml' is .* can be simulated; correct"
    with pytest.raises(RlcoError, match=said):
        load_model(tmp_path / "model.xml")


@pytest.mark.parametrize("asset", ["", "<texture type='2d' builtin='flat' width='8'/>"])
def test_a_model_leaves_no_log_of_mujoco_s_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asset: str
) -> None:
    monkeypatch.chdir(tmp_path)
    body = BODY.replace("name='j'", "name='j' damping='nan'")
    text = f"<mujoco><asset>{asset}</asset><worldbody>{body}</worldbody></mujoco>"
    Path("model.xml").write_text(text)
    with pytest.raises(RlcoError, match="does not compile; MuJoCo says"):
        load_model("model.xml")
    assert [file.name for file in tmp_path.iterdir()] == ["model.xml"]


# -- Files elsewhere ---------------------------------------------------------------


def asset(name: str, compiler: str = "") -> str:
    return f"<mujoco>{compiler}<asset>{name}</asset></mujoco>"


LEAVING = [
    "<mujoco><include file='../secret.xml'/></mujoco>",
    "<mujoco><include file='/etc/passwd'/></mujoco>",
    asset("<mesh file='../../a.stl'/>"),
    asset("<mesh file='..&#47;..&#47;a.stl'/>"),
    asset(r"<mesh file='..\\..\\a.stl'/>"),
    asset("<mesh file='a.stl'/>", "<compiler meshdir='../meshes'/>"),
    asset("<mesh file='a.stl'/>", "<compiler meshdir='/meshes'/>"),
    asset("<mesh file='a.stl'/>", "<compiler assetdir='../meshes'/>"),
    asset("<texture fileup='../a.png' type='cube'/>"),
    asset("<texture file='a.png'/>", "<compiler texturedir='/pictures'/>"),
    asset("<hfield file='/dev/zero'/>"),
    asset("<model file='../other.xml'/>"),
    asset("<skin file='linked/a.skn'/>"),
    # What MuJoCo takes for a name or for words is no comment.
    "<mujoco><body name='<!--'/><include file='/a.xml'/><body name='-->'/></mujoco>",
    "<mujoco><![CDATA[<!--]]><include file='/a.xml'/><![CDATA[-->]]></mujoco>",
    asset("<model file='inner/reads.xml'/>"),  # which reads what lies above arm
    "<robot><mujoco><compiler strippath='false'/></mujoco><link><visual><geometry>"
    "<mesh filename='../a.stl'/></geometry></visual></link></robot>",
]


@pytest.mark.parametrize("xml", LEAVING)
def test_a_model_that_reads_files_elsewhere_is_refused(
    tmp_path: Path, xml: str
) -> None:
    folder = tmp_path / "models" / "arm"
    folder.mkdir(parents=True)
    (folder / "linked").symlink_to(tmp_path)
    (folder / "inner").mkdir()
    mesh = "<mesh file='../../a.stl'/>"
    (folder / "inner" / "reads.xml").write_text(asset(mesh))
    file = folder / "arm.xml"
    file.write_text(xml)
    with pytest.raises(RlcoError, match=r"outside of .*; if you trust the model, give"):
        load_model(file)


@pytest.mark.parametrize(
    "xml",
    [
        "<mujoco><include file='pipe'/></mujoco>",
        asset("<mesh file='pipe'/>"),
        asset("<model file='pipe'/>"),
        asset("<texture fileup='pipe' type='cube'/>"),
    ],
)
def test_a_pipe_that_a_model_reads_is_not_waited_for(tmp_path: Path, xml: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "arm.xml").write_text(xml)
    with pytest.raises(RlcoError, match=r"pipe' is no file; give the model a file"):
        load_model(tmp_path / "arm.xml")


def test_what_lies_elsewhere_is_refused_before_it_is_read(tmp_path: Path) -> None:
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "arm.xml").write_text("<a><include file='../huge.xml'/></a>")
    with (tmp_path / "huge.xml").open("wb") as file:
        file.truncate(2**42)
    with pytest.raises(RlcoError, match="outside of"):
        load_model(tmp_path / "arm" / "arm.xml")
    with pytest.raises(
        RlcoError, match=r"huge\.xml' is a text of 4398046.5 MB, and at"
    ):
        load_model(tmp_path / "arm" / "arm.xml", root=tmp_path)


@pytest.mark.parametrize(
    "xml",
    [
        asset("<mesh file='a.stl'/>", "<compiler meshdir='parts/../meshes'/>"),
        asset("<mesh file='../a.stl'/>", "<compiler meshdir='meshes'/>"),
        asset("<!-- <mesh file='/a.stl'/> --><mesh file='a.stl'/>"),
        # MuJoCo reads the last part of a URDF's paths alone.
        "<robot><link><mesh filename='package://arm/../../a.stl'/></link></robot>",
        asset(f"<mesh file='{Path(pytest.__file__).parent}/a.stl'/>"),  # installed
    ],
)
def test_what_stays_in_its_folder_is_read(tmp_path: Path, xml: str) -> None:
    check_text(tmp_path / "arm.xml", xml)


def test_an_attached_model_reads_from_its_own_folder(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    reads = asset("<mesh file='../a.stl'/><model file='again.xml'/>")
    for name in ("reads", "again"):  # which attach each other
        (tmp_path / "inner" / f"{name}.xml").write_text(reads.replace("again", "reads"))
    check_text(tmp_path / "arm.xml", asset("<model file='inner/reads.xml'/>"))


def test_more_files_than_are_read_are_refused(tmp_path: Path) -> None:
    many = [f"<include file='a{number}.xml'/>" for number in range(201)]
    for number in range(201):
        (tmp_path / f"a{number}.xml").write_text("<mujoco/>")
    check_text(tmp_path / "arm.xml", f"<mujoco>{''.join(many[:200])}</mujoco>")
    with pytest.raises(RlcoError, match="includes or attaches more than 200 files"):
        check_text(tmp_path / "arm.xml", f"<mujoco>{''.join(many)}</mujoco>")


@pytest.mark.parametrize(
    "inside",
    [
        "<body name='<!--'/><replicate count='9'/><body name='-->'/>",
        "<![CDATA[<!--]]><replicate count='9'/><![CDATA[-->]]>",
        "<body/>" * 1001,
        "<body name='unclosed",
    ],
)
def test_what_is_hidden_or_long_is_tried_first(inside: str) -> None:
    assert not trial.is_plain(f"<mujoco><worldbody>{inside}</worldbody></mujoco>")


def test_a_trusted_models_files_may_be_elsewhere(tmp_path: Path) -> None:
    xml = asset("<mesh file='a.stl'/>", "<compiler meshdir='../meshes'/>")
    file = tmp_path / "arm" / "urdf" / "arm.xml"
    file.parent.mkdir(parents=True)
    with pytest.raises(RlcoError, match=rf"give model_root={tmp_path}/arm, a folder"):
        check_text(file, xml)
    check_text(file, xml, tmp_path / "arm")
    (tmp_path / "arm" / "package.xml").write_text("<package/>")  # a ROS package
    check_text(file, xml)


def test_a_model_that_is_tried_first_loads_as_any(tmp_path: Path) -> None:
    few = COPIES.replace("100000000", "3")
    assert not trial.is_plain(few)
    file = tmp_path / "model.xml"
    file.write_text(few)
    assert len(load_model(file).joints) == 3


def test_what_mujoco_says_in_the_trial_is_quoted(tmp_path: Path) -> None:
    file = tmp_path / "model.xml"
    file.write_text(COPIES.replace("count='100000000'", "count='x'"))
    with pytest.raises(RlcoError, match=r"does not compile; MuJoCo says: .*count"):
        load_model(file)


def test_a_model_that_is_no_text(tmp_path: Path) -> None:
    file = tmp_path / "model.xml"
    file.write_bytes(b"<mujoco>\xff\xfe</mujoco>")
    with pytest.raises(RlcoError, match="give an MJCF or URDF file"):
        load_model(file)


def test_a_trial_that_is_killed_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the system does where all memory is taken."""
    monkeypatch.setattr(trial, "_CODE", "import os; os.kill(os.getpid(), 9)")
    file = tmp_path / "model.xml"
    file.write_text(COPIES.replace("100000000", "3"))
    with pytest.raises(RlcoError, match=r"takes more than 2\.0 GB"):
        load_model(file)
