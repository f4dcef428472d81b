"""Containers and clusters, tested without either: names, labels, profiles, and the messages before a run."""

from __future__ import annotations

import configparser
import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from stand_ins import said, stub
from vibraverse.flow.plan import Plan
from vibraverse.flow.steps import STEPS
from vibraverse.machine import compiled, containers, preflight
from workflow_runs import Run

PROFILES = ("default", "apptainer", "slurm", "slurm-apptainer", "kubernetes")


# Rules and profiles


def test_every_rule_that_runs_a_stage_has_the_image_of_its_environment(root):
    for path in (root / "workflow/rules").glob("*.smk"):
        for rule in re.split(r"^ *rule ", path.read_text(), flags=re.M)[1:]:
            environment = re.search(r"envs/(\w+)\.yaml", rule)
            if environment:
                assert f'image("{environment[1]}")' in rule, f"{path.name}: {rule.splitlines()[0]}"
                assert environment[1] in containers.ALL


def test_profiles_agree_where_machines_do_not_matter(root):
    texts = {name: (root / f"workflow/profiles/{name}/config.yaml").read_text() for name in PROFILES}
    shared = texts["default"][texts["default"].index("scheduler:") : texts["default"].index("latency-wait")]
    for name, text in texts.items():
        assert shared in text, name
    loaded = {name: yaml.safe_load(text) for name, text in texts.items()}
    assert {**loaded["slurm"], **loaded["apptainer"], "retries": 2, "latency-wait": 60} == loaded[
        "slurm-apptainer"
    ]


@pytest.fixture(scope="module")
def snakemake_help() -> str:
    """The help of Snakemake and the installed plugins."""
    return subprocess.run(
        [sys.executable, "-m", "snakemake", "--help"], capture_output=True, text=True
    ).stdout


@pytest.mark.parametrize("profile", PROFILES)
def test_profiles_hold_only_options_that_snakemake_knows(root, snakemake_help, profile):
    """Commented ones too; keys of plugins that are not installed here are those of Kubernetes and S3."""
    lines = (root / f"workflow/profiles/{profile}/config.yaml").read_text().splitlines()
    keys = {match[1] for line in lines if (match := re.match(r"(?:# )?([a-z][a-z0-9-]+): ", line))}
    keys = {key for key in keys if not key.startswith(("kubernetes-", "storage-s3-"))}
    assert keys - {"container-image"} <= set(re.findall(r"--([a-z][a-z0-9-]+)", snakemake_help)), profile


def test_the_dockerfile_says_what_the_definitions_say(root):
    docker = (root / "containers/Dockerfile").read_text()
    environment = (root / "containers/environment.sh").read_text()
    for name in ("NUMBA_CACHE_DIR", "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"):
        value = re.search(rf"{name}=(\S+)", environment)[1]
        assert f"{name}={value}" in docker
    assert "://" not in docker + (root / "containers/base.def").read_text()


@pytest.mark.parametrize("family", containers.FAMILIES)
def test_an_images_own_test_runs_every_stage_of_its_family_with_its_packages_alone(root, tmp_path, family):
    """The part of ``containers/check.py`` that needs no image; in a process of its own, for stages start others.

    The workstation's packages are those with which the tests themselves run every stage.
    """
    command = [sys.executable, root / "tests/family_only.py", family, tmp_path]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    ran = set(done.stdout.split())
    assert ran >= {step.name for step in STEPS if step.family == family}


def test_every_stage_is_of_a_family_that_has_an_image():
    assert {step.family for step in STEPS} == set(containers.ALL)


# Names and labels


def test_an_image_is_named_by_family_and_version(monkeypatch, tmp_path):
    monkeypatch.setenv("VIBRAVERSE_IMAGES", str(tmp_path))
    assert containers.image("fem") == f"{tmp_path}/vibraverse-fem-{containers.__version__}.sif"
    monkeypatch.setenv("VIBRAVERSE_IMAGES", "docker://registry.example/shapes/")
    assert (
        containers.image("fem") == f"docker://registry.example/shapes/vibraverse-fem:{containers.__version__}"
    )
    monkeypatch.setenv("VIBRAVERSE_IMAGES", "/my images")
    assert containers.image("fem") is None


def test_an_image_holds_code_and_one_lock():
    names = {str(path) for path in containers.contents("fem")}
    assert {"envs/fem.txt", "workflow/vibraverse/cli.py", "workflow/vibraverse/report/page/synth.js"} <= names
    assert not any("__pycache__" in name or name.startswith("envs/geometry") for name in names)


@pytest.mark.parametrize(
    ("label", "value", "sentence"),
    [
        (None, None, ""),
        ("version", "0.0.9", "is of version 0.0.9, not "),
        ("lock", "0", "was built from other packages than envs/fem.txt pins"),
        ("contents", "0", "was built from another state of the code"),
        ("family", "render", "is of the family render"),
        ("contents", "", "is not an image of this project"),
    ],
)
@pytest.mark.parametrize("command", ["apptainer", "singularity"])
def test_an_image_of_another_making_is_told_from_this_one(
    bin_, tmp_path, monkeypatch, command, label, value, sentence
):
    image = tmp_path / "fem.sif"
    image.touch()
    there = containers.labels("fem")
    if label:
        there[f"vibraverse.{label}"] = value
    (tmp_path / "answer").write_text(json.dumps({"data": {"attributes": {"labels": there}}}))
    monkeypatch.setenv("PATH", str(bin_))  # the system's own is not asked
    stub(bin_, command, f"/bin/cat {tmp_path}/answer")
    found = containers.differences("fem", image)
    assert found.startswith(sentence) if sentence else found == ""


# Building


@pytest.fixture(scope="module")
def build(root):
    """The module ``containers/build.py``."""
    spec = importlib.util.spec_from_file_location("build", root / "containers/build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_pips_settings_are_lent_to_a_build_as_pip_takes_them(build, tmp_path, monkeypatch):
    """Those of the environment take precedence, and lists of indices stay lists."""
    own = tmp_path / "own.conf"
    own.write_text(
        "[global]\nindex-url = https://file.example/simple\ntimeout = 50\nextra-index-url =\n"
        "    https://a.example/simple\n    https://b.example/simple\n"
    )
    monkeypatch.setenv("PIP_CONFIG_FILE", str(own))
    monkeypatch.setenv("PIP_INDEX_URL", "https://environment.example/simple")
    monkeypatch.setenv("PIP_FIND_LINKS", "/wheels https://wheels.example")
    monkeypatch.setenv("UV_CACHE_DIR", str(tmp_path / "cache"))
    assert f"{tmp_path}/pip.conf:/etc/pip.conf" in build.pip_settings(tmp_path)
    lent = configparser.RawConfigParser()  # what pip reads with; it refuses a key that is there twice
    lent.read(tmp_path / "pip.conf")
    expected = {
        "index-url": "https://environment.example/simple",
        "extra-index-url": "https://a.example/simple https://b.example/simple",
        "find-links": "https://wheels.example",
        "timeout": "50",
    }
    assert expected.items() <= dict(lent["global"]).items()


def test_an_unknown_family_is_named(root):
    command = [sys.executable, str(root / "containers/build.py"), "fem", "geom"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("unknown family 'geom'; did you mean 'geometry'? (known: ")


# The sentences before a run


def test_an_unknown_object_or_shard_is_named():
    plan = Plan({"sources": {"generated": {"count": 1, "families": ["bar"]}}, "dataset": {"shards": 1}})
    assert preflight.known(plan, [], "object", "bar-0000") == "bar-0000"
    assert said(preflight.known, plan, [], "object", "bar-000").endswith(
        "; `vibraverse objects` lists those that config.yaml names"
    )
    assert "unknown shard '00007'" in said(preflight.known, plan, [], "shard", "00007")
    sliced = Plan({**plan.config.model_dump(), "slice": "1/1"})
    assert said(preflight.known, sliced, ["my run.yaml"], "object", "cup").endswith(
        "; `vibraverse objects --config 'my run.yaml'` lists those that my run.yaml names; this run is slice 1/1 of all"
    )


@pytest.mark.parametrize(
    ("target", "sentence"),
    [
        (
            "objects/bar-000/solid/modes.h5",
            "an unknown object 'bar-000'; did you mean 'bar-0000'? (known: bar-0000); ",
        ),
        ("dataset/shards/00099.h5", "an unknown shard '00099'"),
    ],
)
def test_a_file_of_an_object_that_is_not_configured_is_one_sentence(root, tmp_path, target, sentence):
    done = Run(tmp_path, root)("--dry-run", f"results/{target}", check=False)
    said = done.stdout + done.stderr
    assert done.returncode == 2
    assert f"\nvibraverse: a file is asked for of {sentence}" in said
    assert "Traceback" not in said


def test_a_product_of_an_object_of_before_may_be_a_source(root, tmp_path):
    """Snakemake looks for jobs that make it, and takes it as it is."""
    before = tmp_path / "results/objects/before/surface.ply"
    before.parent.mkdir(parents=True)
    before.write_text("no run reads it here")
    run = Run(tmp_path, root)
    run.config["sources"] = {
        "generated": {"count": 0},
        "bundled": [],
        "files": [{"path": "results/objects/before/surface.ply"}],
    }
    assert run.plan()[0]["clean"] == 1


def test_without_apptainer(bin_, monkeypatch):
    monkeypatch.setenv("PATH", str(bin_))
    assert "the command apptainer is not on the PATH" in said(preflight.apptainer)
    stub(bin_, "apptainer", "true")
    preflight.apptainer()
    monkeypatch.setenv("VIBRAVERSE_IMAGES", "/my images")
    assert "has a space in its name" in said(preflight.apptainer)


def test_a_missing_image_names_the_remedy(monkeypatch, tmp_path):
    monkeypatch.setenv("VIBRAVERSE_IMAGES", str(tmp_path))
    sentence = said(preflight.images, [containers.image("fem")])
    assert sentence.startswith(f"the image {tmp_path}/vibraverse-fem-")
    assert "does not exist (VIBRAVERSE_IMAGES says where they are); run `make containers`" in sentence
    sentence = said(preflight.images, [containers.image("fem"), containers.image("render")])
    assert sentence.count("does not exist") == 2
    monkeypatch.setenv("VIBRAVERSE_IMAGES", "docker://registry.example/shapes")
    preflight.images([containers.image("fem")])


def test_meshes_that_images_do_not_see(bin_, tmp_path, monkeypatch):
    """The stand-in sees what is bound, and says the rest, as the command in the image would."""
    lines = [
        'echo "$@" >> "$0.log"; bound=; while [ "$1" != sh ]; do [ "$1" = --bind ] && bound=$2; shift; done',
        'shift 4; for file; do case "$file" in "${bound:-none}"/*) ;; *) echo "$file";; esac; done',
    ]
    stub(bin_, "apptainer", "\n".join(lines))
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    near = ["meshes/a.obj", work / "b.obj", "/tmp/c.obj"]
    preflight.seen_in_images(near)
    assert not (bin_ / "apptainer.log").exists()
    sentence = said(preflight.seen_in_images, [*near, "/data/one/d.obj", "/data/one/e.obj"])
    assert sentence.startswith("jobs in images do not see /data/one/")
    assert "--apptainer-args '--bind /data/one'" in sentence
    preflight.seen_in_images(["/data/one/d.obj"], "--nv --bind /data/one")
    assert f"exec --home {work} --nv --bind /data/one" in (bin_ / "apptainer.log").read_text()


@pytest.mark.parametrize(
    ("arguments", "there"),
    [
        (["--workflow-profile", "no/such/slurm", "--cores", "1"], False),
        (["--workflow-profile=no/such/slurm"], False),
        (["--workflow-profile", "slurm"], True),
        (["--workflow-profile", "none"], True),
        (["--cores", "1"], True),
    ],
)
def test_a_profile_that_is_not_there_is_named(tmp_path, monkeypatch, arguments, there):
    """Snakemake would run without a profile, on the machine where it was started."""
    monkeypatch.chdir(tmp_path)
    if there:
        preflight.profile(["snakemake", *arguments])
    else:
        sentence = said(preflight.profile, ["snakemake", *arguments])
        assert sentence.startswith("the profile no/such/slurm does not exist; give its whole path")


def test_resources_of_a_rule_that_is_not_there(root):
    preflight.rules(["basis"], {"basis", "modes"})
    assert "unknown rule 'bases'; did you mean 'basis'?" in said(
        preflight.rules, ["bases"], {"basis", "modes"}
    )


# Compiled loops


def test_loops_on_read_only_storage_are_copied(monkeypatch, tmp_path):
    kept = tmp_path / "kept/geometry_1"
    kept.mkdir(parents=True)
    (kept / "loop.nbi").write_text("compiled")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(kept.parent))
    monkeypatch.delitem(sys.modules, "numba", raising=False)  # which other tests may have loaded
    compiled.use_compiled_loops()
    assert compiled.os.environ["NUMBA_CACHE_DIR"] == str(kept.parent), "what can be written is used in place"
    monkeypatch.setattr(compiled.os, "access", lambda *_: False)
    compiled.use_compiled_loops()
    own = compiled.os.environ["NUMBA_CACHE_DIR"]
    assert own != str(kept.parent)
    assert Path(own, "geometry_1/loop.nbi").read_text() == "compiled"


def test_an_environment_without_the_packages_of_learning(monkeypatch):
    monkeypatch.setattr(preflight, "find_spec", lambda name: None if name == "torch" else name)
    preflight.learning(["tets", "modes"], "1/2", True)
    preflight.learning(["train"], None, False)
    sentence = said(preflight.learning, ["tets", "train"], None, True)
    assert sentence.startswith(
        "the rule train needs the packages of learning, and this environment lacks torch; run"
    )


def test_learning_from_a_slice(monkeypatch):
    monkeypatch.setattr(preflight, "find_spec", lambda name: name)
    preflight.learning(["features"], "join", True)
    sentence = said(preflight.learning, ["features"], "1/2", True)
    assert "would see only the objects of slice 1/2; make all slices first" in sentence
