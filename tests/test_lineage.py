"""Origin, damage and remaking of products: ``provenance``, ``repair``, ``refusals --retry``."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

import make_products
from vibraverse.config import section
from vibraverse.contract import products
from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.flow.paths import Paths
from vibraverse.upkeep.lineage import jobs
from workflow_runs import Run


@pytest.fixture
def run(finished, tmp_path):
    """A copy of the finished run, to break."""
    shutil.copytree(finished.folder / "results", tmp_path / "results")  # keeps the files' times
    shutil.copytree(finished.folder / ".snakemake", tmp_path / ".snakemake")
    return Run(tmp_path, finished.root)


def rot(path: Path) -> None:
    """Change one byte but not the modification time, as a failing disk does."""
    times, content = path.stat(), bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


BODY = "results/objects/bar-0000"


@pytest.mark.parametrize(
    ("broken", "made_by", "jobs"),
    [
        (f"{BODY}/source.mesh", "sources of bar-0000", {"sources": 1, "clean": 1, "hollow": 1, "tets": 2}),
        (f"{BODY}/coarse.obj", "grids of bar-0000", {"grids": 1, "hollow": 1, "clean": None}),
        (f"{BODY}/solid/tets.msh", "tets of bar-0000 (solid)", {"tets": 1, "basis": 1, "modes": 1, "hollow": None}),
        (f"{BODY}/hollow/basis.h5", "basis of bar-0000 (hollow)", {"basis": 1, "modes": 1, "tets": None}),
        (f"{BODY}/hollow/modes.h5", "modes of bar-0000 (hollow)", {"modes": 1, "audio": 1, "basis": None}),
        (f"{BODY}/hollow/sounds/wood.wav", "audio of bar-0000 (hollow)", {"audio": 1, "modes": None}),
        (f"{BODY}/views/clay-00.png", "images of bar-0000", {"images": 1, "clean": None}),
        ("results/dataset/index.tsv", "index", {"index": 1, "dataset": None, "audio": None}),
        ("results/dataset/shards", "dataset", {"dataset": 1, "index": 1, "audio": None}),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_deleted_and_planned_again(run, vibraverse, broken, made_by, jobs):
    path = run.folder / broken
    path = next(path.glob("*.h5")) if path.is_dir() else path
    rot(path)
    results = run.folder / "results"
    status, out, _ = vibraverse("repair", "--results", results)
    assert status == 1
    assert out.startswith(f"{path}: ")
    assert f"made by {made_by}, with" in out
    assert out.count("made by") == 1
    status, out, _ = vibraverse("repair", "--results", results, "--delete")
    assert status == 0
    assert not path.exists()
    planned = run.plan()[0]
    assert {name: planned.get(name) for name in jobs} == jobs
    assert planned["report"] == planned["verdict"] == planned["index"] == 1


@pytest.mark.parametrize(
    ("broken", "made_by", "jobs"),
    [
        ("bar-0000.hollow.js", "page_body of bar-0000 (hollow)", {"page_body": 1, "page_object": 1}),
        ("bar-0000.solid.json", "page_body of bar-0000 (solid)", {"page_body": 1, "page_object": 1}),
        ("bar-0000.webp", "page_object of bar-0000", {"page_body": None, "page_object": 1}),
    ],
)
def test_wrong_data_of_the_page_are_said_deleted_and_planned_again(run, vibraverse, broken, made_by, jobs):
    """Nothing but the page is made from them, so no shard is made again."""
    results = run.folder / "results"
    path = results / "report/data/objects" / broken
    rot(path)
    status, out, _ = vibraverse("repair", "--results", results)
    assert status == 1
    assert out.startswith(f"{path}: it")
    assert f"\n    made by {made_by}, with" in out
    assert out.count("made by") == 1
    assert vibraverse("repair", "--results", results, "--delete")[0] == 0
    assert not path.exists()
    planned = run.plan()[0]
    expected = {**jobs, "report": 1, "dataset": None, "modes": None, "audio": None}
    assert {name: planned.get(name) for name in expected} == expected


def test_a_repair_begins_with_the_last_products_and_goes_down_the_chain(tmp_path, vibraverse, monkeypatch):
    """Stopped anywhere, it leaves a run that remakes the deleted products, or a wrong file that later ones reveal."""
    paths = make_products.build(tmp_path)
    products.write_text(paths.report, "")
    wrong = Path(paths.at(paths.modes, object="bar-0000", solidity="solid"))
    rot(wrong)
    deleted = []
    monkeypatch.setattr(products, "remove", deleted.append)
    assert vibraverse("repair", "--results", tmp_path, "--delete")[0] == 0
    kinds = [path.relative_to(tmp_path).parts[0] for path in deleted]
    assert kinds == sorted(kinds, key=["report", "dataset", "objects"].index)
    first = kinds.index("objects")
    assert deleted[first - 1] == Path(paths.at(paths.shard, shard="1"))
    assert deleted[first] == wrong
    assert [path.name for path in deleted[first + 1 :]] == ["sounds"]


def test_what_is_missing_in_a_folder_is_made_again(run, vibraverse, finished):
    """Snakemake sees only the folder."""
    folder = run.folder / BODY
    (folder / "solid/sounds/wood.wav").unlink()
    (folder / "views/images.json").unlink()
    assert "audio" not in run.plan()[0]
    status, out, _ = vibraverse("repair", "--results", run.folder / "results")
    assert status == 1
    assert f"{folder}/solid/sounds/wood.wav: it is missing" in out
    assert f"{folder}/views/images.json: it is missing" in out
    assert vibraverse("repair", "--results", run.folder / "results", "--delete")[0] == 0
    planned = run.plan()[0]
    assert (planned["audio"], planned["images"]) == (1, 1)
    run()
    assert run.checksums() == finished.checksums()


def test_a_repaired_run_ends_with_the_same_bytes(finished, run, vibraverse):
    for name in ("objects/bar-0000/solid/tets.msh", "objects/bar-0000/views/clay-00.png"):
        rot(run.folder / "results" / name)
    rot(next((run.folder / "results/dataset/shards").glob("*.h5")))
    assert vibraverse("repair", "--results", run.folder / "results", "--delete")[0] == 0
    run()
    assert run.checksums() == finished.checksums()
    assert vibraverse("repair", "--results", run.folder / "results")[1].startswith("Nothing is wrong")


def test_what_the_next_run_makes_anew_is_not_wrong(run, vibraverse):
    """A product that is newer than what was made from it waits for the next run, and is no damage."""
    grids = run.folder / BODY / "solid/modes.h5"
    rot(grids)
    os.utime(grids)
    status, out, _ = vibraverse("repair", "--results", run.folder / "results")
    assert (status, out.splitlines()[0][:16]) == (0, "Nothing is wrong")
    assert run.plan()[0]["audio"] == 1


def test_retried_refusals_run_again_in_a_finished_run(run, vibraverse):
    """The report exists and is up to date; the refused products must still be remade."""
    paths = Paths(run.folder / "results")
    for made in jobs(paths, "bar-0000"):
        if made.solidity == "hollow" and made.step.name != "tets":
            times = made.record.stat()
            for path in made.outputs:
                products.write_text(path, Refusal("bar-0000", "basis", "solve_failed", "No.").to_text())
                os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert read_refusal(run.folder / BODY / "hollow/modes.h5")
    assert run.plan()[0] == {}
    assert vibraverse("refusals", "--results", run.folder / "results", "--retry")[0] == 0
    planned = run.plan()[0]
    assert {name: planned.get(name) for name in ("basis", "modes", "audio", "dataset", "report")} == {
        "basis": 1, "modes": 1, "audio": 1, "dataset": 1, "report": 1,
    }  # fmt: skip


def options_of(words: list[str]) -> tuple[list[str], str]:
    """Return the words of a command without options and threads, and its options."""
    words, options = list(words), "{}"
    for name in ("--options", "--threads"):
        if name in words:
            place = words.index(name)
            value = words[place + 1]
            del words[place : place + 2]
            options = value if name == "--options" else options
    return words, options


def test_the_table_of_stages_says_what_the_rules_do(finished, monkeypatch):
    monkeypatch.chdir(finished.folder)
    for made in jobs(Paths("results"), "bar-0000"):
        name = ".".join(part for part in (made.step.name, made.solidity, "log") if part)
        logged = Path("results/logs/bar-0000", name).read_text().splitlines()[0]
        words, options = options_of(shlex.split(logged))
        found, found_options = options_of(shlex.split(made.command()))
        assert sorted(found) == sorted(words)
        if made.step.options:
            read = section(made.step.options).model_validate_json
            assert read(found_options) == read(options)


def test_the_commands_of_a_product_remake_it(finished, run, vibraverse, monkeypatch):
    monkeypatch.chdir(run.folder)
    status, out, _ = vibraverse("provenance", "results/objects/bar-0000/solid/sounds/steel.wav", "--commands")
    assert status == 0
    commands = out.splitlines()
    assert [shlex.split(line)[1] for line in commands] == [
        "sources",
        "clean",
        "tets",
        "basis",
        "modes",
        "audio",
    ]
    shutil.rmtree("results/objects/bar-0000/solid")
    for command in commands:
        subprocess.run(shlex.split(command), check=True, capture_output=True, env=run.environment)
    assert run.checksums() == finished.checksums()


@pytest.mark.parametrize("file", ["dataset/shards", "dataset/index.tsv", "report/index.html", "verdict.json"])
def test_what_is_made_of_all_objects_leads_back_to_their_sources(finished, vibraverse, monkeypatch, file):
    monkeypatch.chdir(finished.folder)
    path = Path("results") / file
    status, out, _ = vibraverse("provenance", next(path.glob("*.h5")) if path.is_dir() else path)
    assert status == 0
    assert out.startswith("sources of bar-0000: sources, version ")
    assert "    from   generated, bar-0000.ply, licence CC0-1.0\n" in out
    assert out.splitlines()[-1].startswith("    again  vibraverse ")
    assert ", changed since" not in out


@pytest.mark.parametrize(
    ("file", "stage", "before"),
    [("bar-0000.solid.js", "page_body", "modes"), ("bar-0000.thumb.webp", "page_object", "audio")],
)
def test_data_of_the_page_lead_back_to_their_object(finished, vibraverse, monkeypatch, file, stage, before):
    monkeypatch.chdir(finished.folder)
    status, out, _ = vibraverse("provenance", f"results/report/data/objects/{file}", "--commands")
    assert status == 0
    stages = [shlex.split(line)[1] for line in out.splitlines()]
    assert (stages[0], stages[-1]) == ("sources", stage)
    assert before in stages
    assert ("audio" in stages) == (stage == "page_object")


def test_a_script_makes_all_objects_and_keeps_the_splits(tmp_path, vibraverse):
    names = tuple(f"bar-{number:04d}" for number in range(4))
    paths = make_products.make(tmp_path, objects=names)
    shards = make_products.pack(tmp_path, groups=(names[:2], names[2:]))
    kept = tmp_path / "first.tsv"
    kept.write_text("object\tsplit\tcopy_of\nbar-0001\tvalidation\t\n")
    make_products.index(tmp_path, shards, f"--kept={kept}")
    vibraverse()  # forget what the stages said
    _, out, _ = vibraverse("provenance", paths.index)
    assert out.startswith("# 4 objects, each made from a source of its own; --object ID shows one.")
    _, out, _ = vibraverse("provenance", paths.index, "--commands")
    commands = [shlex.split(line) for line in out.splitlines()]
    assert [words[3] for words in commands if words[1] == "clean"] == list(names)
    assert [words[1] for words in commands[-3:]] == ["dataset", "dataset", "index"]
    assert "--kept=FILE" in commands[-1]  # the record holds no paths
    Path(paths.log("index")).parent.mkdir(exist_ok=True)
    Path(paths.log("index")).write_text(f"vibraverse index --kept={kept} --threads 1\n")
    assert f"--kept={kept}" in vibraverse("provenance", paths.index)[1].splitlines()[-1]
    make_products.call(
        *shlex.split(vibraverse("provenance", paths.index, "--commands")[1].splitlines()[-1])[1:]
    )
    assert "bar-0001\tvalidation\t" in Path(paths.splits).read_text()


def test_a_dataset_alone_states_where_its_objects_come_from(finished, tmp_path, vibraverse, monkeypatch):
    """A published dataset: no objects' folders, no logs."""
    shutil.copytree(finished.folder / "results/dataset", tmp_path / "dataset")
    monkeypatch.chdir(tmp_path)
    shard = next(Path("dataset/shards").glob("*.h5"))
    _, here, _ = vibraverse("provenance", shard, "--commands")
    monkeypatch.chdir(finished.folder / "results")
    _, there, _ = vibraverse("provenance", shard, "--commands")
    assert [line.split()[:2] for line in here.splitlines()] == [
        line.split()[:2] for line in there.splitlines()
    ]
    monkeypatch.chdir(tmp_path)
    assert (
        "    from   generated, bar-0000.ply, licence CC0-1.0\n"
        in vibraverse("provenance", "dataset/dataset.json")[1]
    )


def test_a_changed_input_is_reported(run, vibraverse, monkeypatch):
    monkeypatch.chdir(run.folder)
    rot(Path(BODY, "solid/tets.msh"))
    _, out, _ = vibraverse("provenance", f"{BODY}/solid/modes.h5")
    assert sum(line.endswith(", changed since") for line in out.splitlines()) == 2  # for basis and for modes


def test_the_configuration_lies_beside_the_dataset_and_plans_the_same_run(run, vibraverse):
    config = run.folder / "results/dataset/config.yaml"
    record = json.loads((run.folder / "results/dataset/dataset.json").read_text())
    assert record["files"]["config.yaml"]["sha256"] == products.sha256(config)
    assert vibraverse("config", "check", config)[0] == 0
    run.config = {}
    assert run.plan("--configfile", str(config))[0] == {}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("nowhere.h5",), "nowhere.h5 does not exist; name a product"),
        (("config.yaml",), "config.yaml is not in a results folder"),
        (("results/objects/bar-0000/other.txt",), "is not a product of a stage"),
        (("results/dataset/index.tsv", "--object", "bar-0001"), "index.tsv holds no object 'bar-0001'"),
    ],
)  # fmt: skip
def test_mistakes_are_one_sentence(run, vibraverse, monkeypatch, arguments, sentence):
    monkeypatch.chdir(run.folder)
    Path("config.yaml").touch()
    Path("results/objects/bar-0000/other.txt").touch()
    status, _, errors = vibraverse("provenance", *arguments)
    assert status == 2
    assert sentence in errors


def test_an_empty_results_folder_is_one_sentence(tmp_path, vibraverse):
    status, _, errors = vibraverse("repair", "--results", tmp_path)
    assert status == 2
    assert "holds no objects and no dataset" in errors
