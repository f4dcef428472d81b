"""The whole workflow on a tiny configuration: what runs, what reruns, and what survives SIGKILL."""

from __future__ import annotations

import itertools
import json
import random
import re
import shutil
import subprocess
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml

from vibraverse.contract import journal
from vibraverse.contract.refusal import read_refusal
from vibraverse.contract.seeds import rng
from vibraverse.files.tets import read_tets
from vibraverse.flow.paths import Paths
from vibraverse.flow.steps import CHAIN
from vibraverse.physics.basis import build_basis
from vibraverse.physics.materials import MATERIALS
from vibraverse.physics.modes import solve_material
from vibraverse.upkeep import measured
from vibraverse.upkeep.lineage import after, jobs
from workflow_runs import Run, kill_when

LATER = {"dataset": 1, "index": 1, "report": 1, "verdict": 1, "all": 1}


def rerun(stage: str) -> dict[str, int]:
    """Return the jobs that rerun with a stage of one object, counted by rule."""
    first = [made for made in jobs(Paths(), "bar-0000") if made.step.name == stage]
    again = {later for one in first for later in after(one)}
    bodies = {made.solidity for made in again if made.step.name == "modes"}
    shown = {"page_object": 1, **({"page_body": len(bodies)} if bodies else {})}
    return {**Counter(made.step.name for made in again), **shown, **LATER}


@pytest.fixture
def changed(finished):
    """The finished run with a configuration that a test may change; nothing is executed."""
    run = Run(finished.folder, finished.root)
    yield run
    Run(finished.folder, finished.root).command()  # writes the first configuration back


def test_everything_is_made(finished):
    results = finished.folder / "results"
    for path in ("report/index.html", "dataset/index.tsv", "dataset/refusals.tsv", "verdict.json"):
        assert (results / path).stat().st_size > 0
    body = results / "objects/bar-0000/hollow"
    assert (body / "sounds/wood.wav").stat().st_size > 1000
    assert json.loads((results / "dataset/dataset.json").read_text())["counts"]["sounds"] == 4


def test_logs_open_with_the_command_that_repeats_the_job(finished):
    log = finished.folder / "results/logs/bar-0000/tets.hollow.log"
    assert log.read_text().startswith(
        "vibraverse tets --object bar-0000 --solidity hollow --surface results/objects/"
    )


@pytest.mark.parametrize("solidity", ["solid", "hollow"])
def test_strike_gives_the_workflows_frequencies(finished, tmp_path, vibraverse, solidity):
    """The same mesh and material, by one command and from the workflow's tetrahedra with a basis for all materials.

    The corrections are computed at Poisson's ratio of steel here and in the middle of the range there; the last
    modes, which lack those of the modes above, show it.
    """
    import h5py

    folder = finished.folder / "results/objects/bar-0000"
    mesh = shutil.copy(folder / "source.mesh", tmp_path / "anything.ply")
    hollow = json.loads((folder / "hollow/hollow.json").read_text())
    with h5py.File(folder / solidity / "modes.h5") as h5:
        size_m, scale_m, volume_m3 = (h5.attrs[name] for name in ("size_m", "scale_m", "volume_m3"))
    basis = build_basis(*read_tets(folder / solidity / "tets.msh"), rng=rng("bar-0000"), modes=12)
    expected = solve_material(basis, MATERIALS["steel"], scale_m, 12)
    status, _, err = vibraverse(
        "strike", mesh, "--material", "steel", "--size", size_m, "--modes", 12, "--elements", 1200,
        "-o", tmp_path / "a.wav", "--json", tmp_path / "a.json",
        *(["--hollow", hollow["t"]] if solidity == "hollow" else []),
    )  # fmt: skip
    assert status == 0, err
    facts = json.loads((tmp_path / "a.json").read_text())
    np.testing.assert_allclose(facts["frequencies_hz"], expected.frequencies_hz, rtol=2e-3)
    assert facts["volume_m3"] == pytest.approx(volume_m3, rel=1e-9)


def test_every_job_is_in_the_journal(finished, vibraverse):
    results = finished.folder / "results"
    jobs = measured.read(Paths(results))
    (shard,) = (path.stem for path in (results / "dataset/shards").glob("*.h5"))
    assert set(jobs) == {
        *((step.name, "bar-0000", body) for step in CHAIN for body in step.bodies(("solid", "hollow"))),
        *(("page_body", "bar-0000", body) for body in ("solid", "hollow")), ("page_object", "bar-0000", ""),
        ("dataset", shard, ""), ("index", "", ""), ("report", "", ""),
    }  # fmt: skip
    assert {job.outcome for job in jobs.values()} == {"done"}
    assert len({job.run for job in jobs.values()}) == 1
    assert not list(journal.begun(results))
    assert not list(journal.runs(results))
    assert "\ntets " in vibraverse("resources", "--results", results)[1]


def test_snakemakes_own_report(finished, tmp_path):
    finished("--report", str(tmp_path / "report.html"))
    page = (tmp_path / "report.html").read_text()
    assert "index.tsv" in page
    assert "refusals.tsv" in page


def test_nothing_is_left_to_do(changed):
    assert changed.plan()[0] == {}


def test_a_new_material_reruns_modes_and_what_reads_them(changed):
    changed.config["materials"]["brass"] = {
        "density_kg_m3": 8500, "young_pa": 1.0e11, "poisson": 0.34, "alpha_per_s": 5, "beta_s": 5.0e-8,
    }  # fmt: skip
    assert changed.plan()[0] == rerun("modes")


def test_a_new_size_reruns_modes_and_what_reads_them(changed):
    changed.config["sources"]["sizes_m"] = {"bar-0000": 0.4}
    assert changed.plan()[0] == rerun("modes")


def test_a_new_object_runs_alone(changed):
    changed.config["sources"]["generated"]["count"] = 2
    planned, text = changed.plan()
    assert planned == rerun("sources")
    assert "bar-0001: clean the surface" in text
    assert "bar-0000: " not in text


@pytest.mark.parametrize(
    ("section", "key", "value", "expected"),
    [
        ("dataset", "max_refused_share", 0.25, {"verdict": 1, "all": 1}),
        (
            "dataset",
            "stratify",
            "origin",
            {name: count for name, count in LATER.items() if name != "dataset"},
        ),
        ("sampled", "count", 5, rerun("modes")),
        ("report", "title", "Bells", {"report": 1, "verdict": 1, "all": 1}),
        ("audio", "decay_db", 40.0, rerun("audio")),
        ("images", "size_px", 96, rerun("images")),
        ("sources", "objaverse", {"cache": "elsewhere"}, {}),
    ],
)
def test_a_change_reruns_what_depends_on_it(changed, section, key, value, expected):
    changed.config.setdefault(section, {})[key] = value
    assert changed.plan()[0] == expected


@pytest.mark.parametrize(
    ("stage", "expected"),
    [
        ("tets", rerun("tets")),
        ("index", {"index": 1, "report": 1, "verdict": 1, "all": 1}),
    ],
)
def test_raising_a_stage_version_reruns_from_there(changed, tmp_path, stage, expected):
    """Run in a copy of the project."""
    for name in ("Snakefile", "workflow", "envs", "containers"):
        here, there = changed.root / name, tmp_path / name
        if here.is_dir():
            shutil.copytree(here, there, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(here, there)
    steps = tmp_path / "workflow/vibraverse/flow/steps.py"
    raised, count = re.subn(
        rf'(name="{stage}",\s+version=)(\d+)',
        lambda found: f"{found[1]}{int(found[2]) + 1}",
        steps.read_text(),
    )
    assert count == 1
    copy = Run(changed.folder, tmp_path)
    assert copy.plan()[0] == {}
    steps.write_text(raised)
    assert copy.plan()[0] == expected


def test_killed_and_repeated(finished, tmp_path):
    """SIGKILL of the whole process group while jobs work; the same command finishes with the same bytes.

    Only one run may work at a time, and a killed one does not block the next.
    """
    run, draw = Run(tmp_path, finished.root), random.Random(1)
    for kill in range(2):
        process = run.start()
        at_work = run.at_work(draw.randrange(5))
        if kill == 0:
            wait_until_begun(process, tmp_path / "results")
            second = run(check=False)
            assert second.returncode == 1
            said = second.stdout + second.stderr
            assert f"another run (process {process.pid}) is working in results; wait for it" in said
        assert kill_when(process, at_work)
        assert not journal.working_runs(tmp_path / "results")
        assert list(journal.begun(tmp_path / "results"))
    run()
    assert run.checksums() == finished.checksums()
    assert not list((tmp_path / "results").rglob(".*.partial.*"))
    assert not list(journal.begun(tmp_path / "results"))


def wait_until_begun(process: subprocess.Popen, results: Path) -> None:
    """Wait until a run holds the results folder."""
    while not journal.working_runs(results):
        assert process.poll() is None
        time.sleep(0.05)


def test_a_configuration_file_stands_alone(finished, tmp_path):
    """The run is what ``vibraverse config show FILE`` prints, whatever ``config.yaml`` says; spaces are allowed."""
    run = Run(tmp_path, finished.root)
    run.config["results"] = "my results"
    run.config["materials"] = {"glass": None}
    (tmp_path / "only.yaml").write_text(yaml.safe_dump(run.config))
    run.config = {"materials": {"tin": None}}
    done = run("--dry-run", "--printshellcmds", "--configfile", str(tmp_path / "only.yaml"))
    text = done.stdout + done.stderr
    assert "'my results/objects/bar-0000/solid/sounds'" in text
    assert '"materials": {"glass"' in text
    assert "> 'my results/logs/bar-0000/audio.solid.log' 2>&1" in text
    assert '"tin"' not in text


def test_every_job_is_printed_with_its_own_command(tmp_path, root):
    """A command is cached for the three times that Snakemake asks for it, and not for the next job."""
    run = Run(tmp_path, root)
    run.config["sources"]["generated"]["count"] = 3
    done = run("--dry-run", "--printshellcmds")
    lines = (done.stdout + done.stderr).splitlines()
    commands = {
        tuple(named.groups(default="")): following
        for line, following in itertools.pairwise(lines)
        if (named := re.match(r"Job \d+: (bar-\d+)(?:, (solid|hollow))?: (.*)", line))
    }
    assert len(commands) == 3 * 16
    for (name, solidity, _), command in commands.items():
        assert command.startswith("Shell command: vibraverse ")
        assert f" --object {name} " in command
        assert not solidity or f" --solidity {solidity} " in command
    assert len(set(commands.values())) == len(commands)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"materials": {"ceramik": None}}, "unknown material 'ceramik'; did you mean 'ceramic'?"),
        (
            {"tets": {"target_elemnts": 3}},
            "unknown key 'tets.target_elemnts'; did you mean 'target_elements'?",
        ),
        ({"sources": {"files": [{"path": "no/such/folder"}]}}, "no/such/folder"),
        ({"sources": {"files": [{"path": "*.obj"}]}}, "*.obj"),
    ],
)
def test_a_bad_configuration_is_one_sentence(tmp_path, root, change, sentence):
    run = Run(tmp_path, root)
    run.config.update(change)
    done = run(check=False)
    assert done.returncode == 2
    (said,) = [
        line
        for line in (done.stdout + done.stderr).splitlines()
        if "onfig file" not in line and "profile" not in line
    ]
    assert said.startswith("vibraverse: ")
    assert sentence in said
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"a: [b\n", "config.yaml, line 2, column 1 is not valid YAML: expected ',' or ']', but got"),
        (b"- a\n", 'config.yaml must hold keys and values, not ["a"]'),
        (b"", "config.yaml holds no keys; write {} for a run with every default"),
        (b"a: \xff\n", "config.yaml is not valid YAML: 'utf-8' codec can't decode byte 0xff"),
    ],
)
def test_a_file_that_is_no_configuration_is_named(tmp_path, root, content, sentence):
    """Snakemake itself would end with a traceback, or with a message that does not name the file."""
    run = Run(tmp_path, root)
    run.config = content
    done = run("--dry-run", check=False)
    assert done.returncode == 2
    assert f"\nvibraverse: {sentence}" in done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr


def test_a_file_beside_the_one_that_is_named_is_not_read(tmp_path, root):
    run = Run(tmp_path, root)
    (tmp_path / "only.yaml").write_text(yaml.safe_dump(run.config))
    run.config = b"a: [b\n"
    run("--dry-run", "--configfile", "only.yaml")


def test_bad_meshes_are_records_and_the_rest_goes_on(finished, tmp_path):
    """Bad files beside a good object: each is refused, the run succeeds, and the summary says so."""
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    (meshes / "nothing.obj").write_bytes(b"")
    (meshes / "text.glb").write_text("this is no glb")
    (meshes / "cut.obj").write_text("v 0 0 0\nv 1 0 0\nf 1 2 3\n")
    (meshes / "nan.obj").write_text("v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n")
    (meshes / "points.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"
    )
    shutil.copytree(finished.folder / "results", tmp_path / "results")
    run = Run(tmp_path, finished.root)
    run.config["sources"]["files"] = [{"path": "meshes"}]
    run.config["dataset"]["max_refused_share"] = 0.9
    done = run()
    objects = tmp_path / "results/objects"
    reasons = {
        name: read_refusal(objects / name / "surface.ply")
        for name in ("nothing", "text", "cut", "nan", "points")
    }
    assert {name: refusal.reason for name, refusal in reasons.items()} == {
        "nothing": "empty", "text": "unreadable", "cut": "unreadable", "nan": "not_finite", "points": "empty",
    }  # fmt: skip
    for name, refusal in reasons.items():
        assert name in refusal.message
        assert refusal.advice
    assert "5 of 6 objects refused" in done.stdout + done.stderr
    # Too many refusals fail the run loudly; repairing a file and retrying makes it again.
    run.config["dataset"]["max_refused_share"] = 0.5
    failed = run(check=False)
    assert failed.returncode != 0
    assert "Too much is refused: 5 of 6 objects (83%)" in failed.stdout + failed.stderr
