"""Rules, pages and tests follow the steps; a new stage touches six places."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
import yaml

from vibraverse.contract.step import BODY, OBJECT
from vibraverse.flow.paths import Paths
from vibraverse.flow.steps import BY_NAME, CHAIN, STEPS
from workflow_runs import TINY, Run

#: Inputs that a rule hands over as a parameter, since they need not exist when a run is planned.
AS_PARAMETERS = {("index", "resolved"), ("report", "learning"), ("learn_page", "report")}
#: Inputs that a function of the wildcards lists.
LISTED = {("baselines", "descents")}
#: Inputs that the stage finds by itself, listed in the rule for Snakemake's sake.
FOUND_BY_THE_STAGE = {("dataset", "products"), ("report", "objects")}
_VALIDATION = dict.fromkeys(("validation_meshes", "validation_modes", "validation_table"), "validation")
_LEARNING = dict.fromkeys(
    ("features", "train", "evaluate", "diffsound", "baselines", "results", "learn_page"), "learn"
)
#: Stages that share a page in ``docs/``, and stages that share a test file, each with its name.
SHARED_PAGES = {
    "index": "dataset",
    "page_body": "report",
    "page_object": "report",
    **_VALIDATION,
    **_LEARNING,
}
SHARED_TESTS = {**_VALIDATION, "evaluate": "tasks", "baselines": "tasks", "results": "tasks"}
#: Stages of other runs than the one that ``docs/architecture.md`` draws.
NOT_DRAWN = {*_VALIDATION}


@pytest.fixture(scope="module")
def rules(root, tmp_path_factory) -> dict[str, dict]:
    """The rules as Snakemake understands them, of a run with every optional input."""
    folder = tmp_path_factory.mktemp("rules")
    paths = Paths(folder / "results")
    for place in (paths.validation_record, paths.learn_page, paths.report, folder / "kept.tsv"):
        Path(place).parent.mkdir(parents=True, exist_ok=True)
        Path(place).touch()
    config = {**TINY, "results": paths.results, "audio": {"points": [[0.0, 0.0, 1.0]]}}
    config["dataset"] = {**TINY.get("dataset", {}), "keep_splits": str(folder / "kept.tsv")}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    program = [sys.executable, str(Path(__file__).with_name("list_rules.py"))]
    listed = subprocess.run(
        [*program, str(root / "Snakefile"), str(folder / "config.yaml")],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert listed.returncode == 0, listed.stderr
    return {"paths": paths, **json.loads(listed.stdout)}


def test_every_stage_has_a_rule_of_its_name(rules, root):
    for name in BY_NAME:
        assert (root / f"workflow/vibraverse/stages/{name}.py").is_file(), (
            f"the step {name} has no module: write workflow/vibraverse/stages/{name}.py"
        )
        assert (root / f"workflow/rules/{name}.smk").is_file(), no_rule(name)
        assert name in rules, no_rule(name)


def no_rule(name: str) -> str:
    return f"the step {name} has no rule: write workflow/rules/{name}.smk"


def page_of(name: str) -> str:
    return f"docs/{SHARED_PAGES.get(name, name)}.md"


@pytest.mark.parametrize("name", BY_NAME)
def test_a_stage_has_a_page_and_a_test(root, name):
    page, test = root / page_of(name), f"test_{SHARED_TESTS.get(name, name)}.py"
    assert page.is_file(), (
        f"the step {name} has no page: write {page_of(name)}, or name the page that it shares in SHARED_PAGES"
    )
    assert name in page.read_text(encoding="utf-8"), f"{page_of(name)} does not name the step {name}"
    assert list((root / "tests").rglob(test)), (
        f"the step {name} has no test: write tests/{test}, or name the file that it shares in SHARED_TESTS"
    )


def test_the_readme_links_the_page_of_every_stage(root):
    text = (root / "README.md").read_text(encoding="utf-8")
    missing = {page_of(name) for name in BY_NAME if f"]({page_of(name)})" not in text}
    assert not missing, f"README.md has no link to {', '.join(sorted(missing))}: add it to its list of stages"


def test_the_architecture_draws_every_stage(root):
    text = (root / "docs/architecture.md").read_text(encoding="utf-8")
    drawn = set(re.findall(r"\w+", text.split("```")[1]))
    missing, strange = set(BY_NAME) - NOT_DRAWN - drawn, drawn - set(BY_NAME)
    assert not missing, f"docs/architecture.md does not draw {', '.join(sorted(missing))}; see also NOT_DRAWN"
    assert not strange, f"docs/architecture.md draws {', '.join(sorted(strange))}, which are no steps"


@pytest.mark.parametrize("page", ["docs/install.md", "docs/containers.md"])
@pytest.mark.parametrize("family", sorted({step.family for step in STEPS}))
def test_tables_of_the_families_name_their_stages(root, page, family):
    row = re.search(rf"^\| `{family}` \| ([^|]*)\|", (root / page).read_text(encoding="utf-8"), re.MULTILINE)
    assert row, f"{page} has no row `{family}` in its table of families"
    named = set(re.findall(r"\w+", row[1])) & set(BY_NAME)
    stages = {step.name for step in STEPS if step.family == family}
    missing, strange = stages - named, named - stages
    assert not missing, f"{page}: the row `{family}` lacks {', '.join(sorted(missing))}"
    assert not strange, f"{page}: the row `{family}` names {', '.join(sorted(strange))} of other families"


@pytest.mark.parametrize("name", BY_NAME)
def test_a_rule_says_what_its_step_says(rules, name):
    assert name in rules, no_rule(name)
    step, rule, paths = BY_NAME[name], rules[name], rules["paths"]
    outputs = {key: getattr(paths, output.pattern) for key, output in step.outputs.items()}
    assert rule["output"] == outputs
    inputs = {key for key in step.inputs if (name, key) not in AS_PARAMETERS}
    assert {key for key in rule["input"] if (name, key) not in FOUND_BY_THE_STAGE} == inputs
    for key, input_ in step.chained.items():
        if (name, key) in AS_PARAMETERS:
            assert rule["params"][key].removeprefix(f"--{key}=") == getattr(paths, input_.pattern)
            continue
        pattern, given = getattr(paths, input_.pattern), rule["input"][key]
        if (name, key) in LISTED:
            assert given == "<lambda>"
        elif callable(pattern):
            assert given == f"<{pattern.__name__}>"
        elif input_.many:
            before, after = pattern.partition("{")[0], pattern.rpartition("}")[2]
            assert given
            assert all(one.startswith(before) and one.endswith(after) for one in given)
        else:
            assert given in (pattern, [pattern])
    assert rule["log"] == [paths.log(name, *step.wildcards)]
    assert rule["conda"] == f"../../envs/{step.family}.yaml"
    assert f"vibraverse-{step.family}-" in rule["container"]
    assert rule["params"]["version"] == str(step.version)
    assert ("options" in rule["params"]) == bool(step.options)
    words = rule["shell"].removeprefix("exec vibraverse gpus --claim {resources.gpu} -- ").split()
    assert words[:2] == ["vibraverse", name]
    for wildcard in step.wildcards if step.per in (OBJECT, BODY) else ():
        flag = f"--{wildcard} {{wildcards.{wildcard}}}"
        assert flag in " ".join(words), f"the command of the rule {name} lacks {flag}"
    for key in (*step.inputs, *step.outputs):
        flag = f"--{key.replace('_', '-')}"
        as_text = f"{{params.{key}}}"  # a parameter that holds flag and value, or nothing
        assert flag in words or as_text in words, key


def test_products_have_one_name_and_one_place():
    outputs = [output for step in STEPS for output in step.outputs.values()]
    assert (
        len({output.pattern for output in outputs})
        == len({output.path for output in outputs})
        == len(outputs)
    )
    for step in STEPS:
        for output in step.outputs.values():
            assert all(f"{{{wildcard}}}" in output.path for wildcard in step.wildcards)
        assert step.record in step.outputs or step.name in ("report", "learn_page")
        assert step.passes_refusals == (
            step.per
            not in (
                "shard",
                "shown object",
                "dataset",
                "validation",
                "training",
                "comparison",
                "part",
                "learning",
            )
        )


def test_every_input_is_made_by_an_earlier_stage():
    made = {"config"}  # written as a run starts
    for step in STEPS:
        for name, input_ in step.chained.items():
            sources = ("surface", "hollow_surface") if input_.pattern == "boundary" else (input_.pattern,)
            # The report shows a validation and links learning where they were run; those are runs of their own.
            own = ("validation", "learning")
            assert made.issuperset(sources) or (step.name == "report" and name in own)
        made |= {output.pattern for output in step.outputs.values()}


TOY_STEP = """
    Step(
        name="roundness",
        version=1,
        help="measure how round the surface is",
        per=OBJECT,
        family="geometry",
        inputs={"surface": Input("surface", "cleaned surface (PLY)")},
        outputs={"record": Output("roundness", "objects/{object}/roundness.json", "isoperimetric quotient (JSON)")},
        record="record",
        libraries=("numpy",),
        imports=("vibraverse.geometry.roundness", "vibraverse.files.meshes"),
    ),
"""
TOY_STAGE = '''"""Stage ``roundness``: how round a body is."""


def run(job) -> None:
    """Read the surface, write its isoperimetric quotient."""
    from vibraverse.files import meshes
    from vibraverse.geometry.roundness import quotient

    job.write_record({"roundness": quotient(*meshes.read_ply(job.inputs["surface"]))})
'''
TOY_LIBRARY = '''"""The isoperimetric quotient ``36 π V² / A³``: 1 for a ball, less for anything else."""

import numpy as np

from vibraverse.geometry import surfaces


def quotient(vertices, faces) -> float:
    """Return the quotient of a closed surface."""
    return float(36 * np.pi * surfaces.volume(vertices, faces) ** 2 / surfaces.area(vertices, faces) ** 3)
'''
TOY_RULE = """rule roundness:
    input:
        surface=paths.surface,
    output:
        record=paths.roundness,
    log:
        paths.log("roundness", "object"),
    conda:
        "../../envs/geometry.yaml"
    container:
        image("geometry")
    params:
        version=VERSIONS["roundness"],
    shell:
        "vibraverse roundness --object {wildcards.object} "
        "--surface {input.surface:q} --record {output.record:q} > {log:q} 2>&1"
"""


@pytest.fixture
def grown(root, tmp_path, finished):
    """A copy of the tree in which a stage was added, and a copy of the finished run that it works on."""
    tree = tmp_path / "tree"
    for folder in ("workflow", "envs", "containers"):
        shutil.copytree(root / folder, tree / folder, ignore=shutil.ignore_patterns("images", "__pycache__"))
    for file in ("Snakefile", "config.yaml", "pyproject.toml"):
        shutil.copyfile(root / file, tree / file)
    (tree / "profiles").symlink_to("workflow/profiles")
    package = tree / "workflow/vibraverse"
    steps = (package / "flow/steps.py").read_text()
    before = '    Step(\n        name="hollow"'
    assert before in steps
    (package / "flow/steps.py").write_text(steps.replace(before, f"{TOY_STEP.strip(chr(10))}\n{before}"))
    (package / "stages/roundness.py").write_text(TOY_STAGE)
    (package / "geometry/roundness.py").write_text(TOY_LIBRARY)
    (tree / "workflow/rules/roundness.smk").write_text(TOY_RULE)
    run_in = tmp_path / "run"
    shutil.copytree(finished.folder, run_in, symlinks=True)
    return Run(run_in, tree)


def test_a_new_stage_touches_six_places(grown, monkeypatch, root):
    """Its mathematics, stage module, step and rule; its docs page and its test are for people.

    The commands for people know it, the command that repeats its job runs, and so does what other tests work on.
    """
    monkeypatch.setenv("PYTHONPATH", str(grown.root / "workflow"))
    jobs, _ = grown.plan()
    assert jobs["roundness"] == 1
    assert not set(jobs) & {step.name for step in CHAIN}
    grown()
    product = grown.folder / "results/objects/bar-0000/roundness.json"
    record = json.loads(product.read_text())
    assert 0.05 < record["roundness"] < 1
    assert record["provenance"]["stage"] == "roundness"

    def python(*words: str) -> str:
        places = os.pathsep.join([grown.environment["PYTHONPATH"], str(root / "tests")])
        done = subprocess.run(
            [sys.executable, *words], cwd=grown.folder, env={**grown.environment, "PYTHONPATH": places},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    def vibraverse(*words: str) -> str:
        return python("-m", "vibraverse", *words)

    assert "roundness" in vibraverse("--help")
    assert "36 π" not in vibraverse("roundness", "--help")
    assert "roundness" in vibraverse("status")
    assert "roundness, version 1" in vibraverse("provenance", "results/objects/bar-0000/roundness.json")
    assert vibraverse("repair").startswith("Nothing is wrong")

    command = vibraverse("provenance", str(product), "--commands").splitlines()[-1]
    product.unlink()
    vibraverse(*shlex.split(command)[1:])
    assert json.loads(product.read_text()) == record

    python("-c", "from pathlib import Path; import make_products; make_products.build(Path('others'))")
    with h5py.File(next((grown.folder / "others/dataset/shards").glob("*.h5"))) as shard:
        assert json.loads(shard["making"].asstr()[()])["roundness"]["stage_version"] == 1


def test_the_architecture_names_the_six_places(root):
    text = (root / "docs/architecture.md").read_text(encoding="utf-8")
    for place in (
        "flow/steps.py",
        "stages/<stage>.py",
        "workflow/rules/<stage>.smk",
        "docs/<stage>.md",
        "tests/",
    ):
        assert place in text
    assert BY_NAME["clean"].per == OBJECT
