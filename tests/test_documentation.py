"""Every command and snippet that the documentation shows runs, in copies of the finished tiny run.

What computes for long is planned (``-n``) or made small; placeholders stand for files that lie there. What cannot run
here is listed with its reason, and so is what is no command; an entry that matches nothing any more fails.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile
import trimesh

import documented
from stand_ins import stub
from vibraverse.cli import COMMANDS
from vibraverse.flow.steps import BY_NAME
from workflow_runs import TINY, Run

#: What cannot run here, by a pattern of the command, and why.
CANNOT = {
    r"python3 -m venv ": "makes another environment, from a network",
    r"(venv/bin/)?pip install ": "installs, from a network",
    r"pip config": "changes the user's settings",
    r"conda env create": "takes Conda and a network",
    r"docker build": "takes Docker",
    r"apptainer inspect IMAGE": "takes Apptainer and an image",
    r"snakemake --sdm conda …": "takes Conda",
    r"vibraverse gpus --claim$": "names an option; the whole commands stand in docs/gpu.md",
    r"python docs/images/": "draws for minutes",
    r"python -m http.server ": "serves until it is stopped; tests/test_report_datasets.py serves the page likewise",
    r"vibraverse predict ": "takes PyTorch and a trained model; tests/learn/test_predict.py runs it",
}
#: Blocks without a language that hold no commands, by how they begin, and what they are.
NO_COMMANDS = {
    "sources ->": "the chain of stages",
    "Snakefile ": "the tree of the project",
    "vibraverse: ": "what a command answers",
    "path,id,size_m": "a manifest",
    "rule train:": "a rule",
    '    "thickness": ': "a line of a dictionary",
    "    thickness: LearningTask": "a field of a class",
    "set-resources:": "lines of a profile",
}
#: Files that the reader of an example writes.
EXAMPLES = ("train.py", "workflow/vibraverse/learn/tasks/thickness.py")
#: Words that a command of the documents may begin with.
FIRST_WORDS = (
    "vibraverse ", "snakemake ", "make ", "python ", "python3 ", "pip ", "venv/bin/pip ", "conda ", "docker ", "cd ",
    "VERSION=",
)  # fmt: skip
#: What stands for what in the run here: names of objects, placeholders, sizes.
STANDS_FOR = (
    (r"bowl-0000|\bsnail\b|(?<=--retry )ID\b", "bar-0000"),
    (r"\[FILE\]|(?<=check )FILE\b", "config.yaml"),
    (r"--cores N\b", "--cores 2"),
    (r"slice=3/50", "slice=1/1"),
    (r"--slices 50", "--slices 1"),
    (r"\bmake ", "make -n "),
    (r"^(snakemake(?!.* (-n|--lint)\b).*)$", r"\1 -n"),
    (r"^(vibraverse submit(?!.*--dry-run).*)$", r"\1 --dry-run"),
    (r"^(vibraverse strike .*)$", r"\1 --elements 300 --order 1 --modes 8"),
    (r"^(vibraverse listen .*)$", r"\1 --elements 300 --order 1"),
    (r"^(python benchmarks/\w+\.py).*", r"\1 --help"),
)


def reason(command: str) -> str:
    """Return why a command cannot run here; "" if it can."""
    return next((why for pattern, why in CANNOT.items() if re.match(pattern, command)), "")


def made_runnable(command: str) -> str:
    """Return a command with its placeholders filled in and its work made small."""
    for pattern, instead in STANDS_FOR:
        command = re.sub(pattern, instead, command)
    return command


def command_blocks() -> list[documented.Block]:
    return [
        block
        for block in documented.blocks("", "bash", "sh", "console")
        if not block.text.startswith(tuple(NO_COMMANDS))
    ]


#: Commands amid sentences, but for names of a command alone.
SPANS = {
    command: doc
    for command, doc in documented.spans().items()
    if not re.fullmatch(r"vibraverse [a-z_]+|\w+ -n", command) and not reason(command)
}


@pytest.fixture(scope="module")
def clone(finished, tmp_path_factory) -> Run:
    """A folder like a clone, with a finished run that has everything the documents mention."""
    run = Run(tmp_path_factory.mktemp("documented") / "clone", finished.root)
    shutil.copytree(finished.folder, run.folder, ignore=shutil.ignore_patterns("dataset"))
    run.config = {
        **TINY,
        "materials": {"steel": None, "wood": None, "glass": None},
        "sampled": {"count": 8},
        "audio": {"max_s": 0.2, "points": [[0.9, 0, 0]], "sampled": 1},
        "images": {"views": 1, "looks": ["clay", "steel", "wood"], "size_px": 64},
        "dataset": {"shards": 1},
    }
    run()
    for name in (
        "Snakefile",
        "Makefile",
        "workflow",
        "envs",
        "benchmarks",
        "examples",
        "docs",
        "pyproject.toml",
    ):
        (run.folder / name).symlink_to(finished.root / name)
    of_object = run.folder / "results/objects/bar-0000"
    for name in ("source.mesh", "source.json", "surface.ply", "clean.json", "grids.h5"):
        shutil.copy(of_object / name, run.folder / name)
    for name in ("tets.msh", "basis.h5"):
        shutil.copy(of_object / "solid" / name, run.folder / name)
    for folder in ("my-meshes", "home/meshes", "mugs", "scans"):
        (run.folder / folder).mkdir(parents=True)
    for name in (
        "mug.obj",
        "mug.stl",
        "mesh.obj",
        "my-meshes/mug.stl",
        "home/meshes/mug.obj",
        "mugs/blue.obj",
    ):
        trimesh.creation.box((1.0, 0.6, 0.5)).export(run.folder / name)
    time_s = np.arange(22_050) / 44_100
    tones_hz = (900.0, 1770.0, 2900.0, 4100.0)
    chord = np.exp(-20 * time_s) * sum(np.sin(2 * np.pi * one * time_s) for one in tones_hz)
    soundfile.write(run.folder / "mug.wav", chord / 5, 44_100)
    (run.folder / "heard.txt").write_text("".join(f"{one}, 20\n" for one in tones_hz))
    (run.folder / "shapes.csv").write_text("path,size_m\nmugs/blue.obj,0.1\n")
    (run.folder / "train.py").write_text("print('trained')\n")
    mine = next(block for block in documented.blocks("yaml") if block.doc == "README.md")
    (run.folder / "mine.yaml").write_text(mine.text)
    (run.folder / ".venv/bin").mkdir(parents=True)
    (run.folder / ".venv/bin/activate").touch()
    shutil.copytree(run.folder / "results", run.folder / "my-results")
    shutil.copytree(run.folder / "results/dataset", run.folder.parent / "cluster/results/dataset")
    bin_ = run.folder.parent / "bin"
    bin_.mkdir()
    stub(bin_, "nvidia-smi", "\n".join(f"echo '{n}, GPU-{n}, NVIDIA A, 81559, 4'" for n in range(4)))
    stub(bin_, "torchrun", "echo trained")
    stub(bin_, "apptainer", "echo apptainer version 1.3.4")
    done = shell(run.folder, "vibraverse join results/dataset -o all.h5")
    assert done.returncode == 0, done.stderr
    return run


#: Commands that have run, with their placeholders filled in: pages repeat each other, and a run is enough.
RAN: set[str] = set()


def runs(folder: Path, command: str, place: str) -> None:
    """Run a command of a page, unless another page showed it."""
    runnable = made_runnable(command)
    if runnable in RAN:
        return
    done = shell(folder, runnable)
    assert done.returncode == 0, f"{place}: {command}\n{done.stdout}{done.stderr}"
    RAN.add(runnable)


def shell(folder: Path, command: str) -> subprocess.CompletedProcess:
    """Run a command in a clone as a user would, with the stand-ins beside it first in the PATH."""
    environment = {
        **os.environ,
        "PATH": os.pathsep.join(
            [str(folder.parent / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]]
        ),
        "HOME": str(folder / "home"),
        "MPLBACKEND": "agg",
        "VIBRAVERSE_GPU_LOCKS": str(folder / "locks"),
    }
    words = ["bash", "-c", command]
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=600)


@pytest.fixture
def copied(clone, tmp_path) -> Path:
    """A copy of the clone."""
    shutil.copytree(clone.folder.parent, tmp_path / "copy", symlinks=True)
    return tmp_path / "copy/clone"


@pytest.mark.parametrize("block", command_blocks(), ids=lambda block: block.place)
def test_a_block_of_commands_runs(block, copied):
    for command in documented.commands(block.text):
        assert command.startswith(FIRST_WORDS), f"{block.place}: is {command!r} a command?"
        if not reason(command):
            runs(copied, command, block.place)


@pytest.mark.parametrize("command", SPANS)
def test_a_command_amid_a_sentence_runs(command, copied):
    runs(copied, command, SPANS[command])


def test_commands_named_amid_a_sentence_exist():
    for command, doc in documented.spans().items():
        if name := re.fullmatch(r"vibraverse ([a-z_]+)", command):
            assert name[1] in COMMANDS or name[1] in BY_NAME, f"{doc} names {command}"


@pytest.mark.parametrize("block", documented.blocks("yaml"), ids=lambda block: block.place)
def test_a_configuration_is_valid(block, copied):
    (copied / "shown.yaml").write_text(block.text + "\nresults: results\n" * ("results:" not in block.text))
    done = shell(copied, "vibraverse config check shown.yaml")
    assert done.returncode == 0, f"{block.place}\n{done.stderr}"


@pytest.mark.parametrize("block", documented.blocks("python"), ids=lambda block: block.place)
def test_a_snippet_of_python_runs(block, copied):
    if "torch" in block.text or "set_epoch" in block.text:
        pytest.importorskip("torch", reason="is tested in the environment of learning")
    lines = [
        "import h5py, numpy as np, os, vibraverse.dataset",
        "reader = vibraverse.dataset.open('results/dataset')",
        "os.chdir('results/dataset')" if '"shards/' in block.text else "",
        block.text.replace("bowl-0000", "bar-0000"),
    ]
    (copied / "snippet.py").write_text("\n".join(lines))
    done = shell(copied, "python snippet.py")
    assert done.returncode == 0, f"{block.place}\n{done.stderr}"


def test_every_exception_is_still_needed():
    every = [command for block in command_blocks() for command in documented.commands(block.text)]
    every += documented.spans()
    for pattern in CANNOT:
        assert any(re.match(pattern, command) for command in every), f"nothing is like {pattern!r} any more"
    for pattern, _ in STANDS_FOR:
        assert any(re.search(pattern, command) for command in every), f"nothing is like {pattern!r} any more"
    plain = [block.text for block in documented.blocks("", "bash", "sh", "console")]
    for beginning in NO_COMMANDS:
        assert any(text.startswith(beginning) for text in plain), (
            f"no block begins with {beginning!r} any more"
        )


def test_files_of_code_that_are_named_exist(root):
    places = (root, root / "workflow", root / "workflow/vibraverse")
    for name, docs in documented.paths_of_code().items():
        assert any((place / name).is_file() for place in places) or name in EXAMPLES, f"{docs} name {name}"
