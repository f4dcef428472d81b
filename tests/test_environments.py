"""The environments: locks that agree with pyproject.toml and each other, and the scripts that install them.

Nothing here touches the network or apt: interpreter, uv, apt-get and sudo are stand-ins that write down their calls.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent
ENVS = ROOT / "envs"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
FAMILIES = list(PROJECT["project"]["optional-dependencies"])


def load(name: str):
    """Return a script of this folder as a module."""
    spec = importlib.util.spec_from_file_location(name, ENVS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


lock = load("lock")
REQUIRED = lock.environments(PROJECT)


def pins(name: str) -> dict[str, str]:
    """Return name -> version of a lock."""
    listed = [Requirement(pin) for pin in lock.pins((ENVS / f"{name}.txt").read_text())]
    return {pin.name: str(pin.specifier).removeprefix("==") for pin in listed}


# The locks


def test_every_family_has_an_environment():
    assert set(REQUIRED) == {"bootstrap", "node", "workstation", *FAMILIES}
    assert {path.stem for path in ENVS.glob("*.txt")} == {*REQUIRED, "system"}
    assert {path.stem for path in ENVS.glob("*.yaml")} == set(REQUIRED) - {"bootstrap", "node"}


@pytest.mark.parametrize("name", sorted(set(REQUIRED) - {"bootstrap", "node"}))
def test_conda_and_pip_pin_the_same(name):
    conda = yaml.safe_load((ENVS / f"{name}.yaml").read_text())
    python, pip, packages = conda["dependencies"]
    assert (conda["name"], python, pip) == (f"vibraverse-{name}", f"python={lock.PYTHON}", "pip")
    assert packages["pip"] == lock.pins((ENVS / f"{name}.txt").read_text())


@pytest.mark.parametrize("name", sorted(REQUIRED))
def test_every_pin_has_hashes(name):
    text = re.sub(r"^ *#.*\n", "", (ENVS / f"{name}.txt").read_text(), flags=re.MULTILINE)
    entries = re.split(r"\n(?=\S)", text.strip())
    assert len(entries) == len(lock.pins(text)) >= (1 if name == "node" else 2)
    for entry in entries:
        pin, *hashes = entry.split(" \\\n")
        assert "==" in pin
        assert hashes
        assert all(re.fullmatch(r" {4}--hash=sha256:[0-9a-f]{64}", line) for line in hashes), pin


def test_a_package_has_one_version_everywhere():
    seen: dict[str, str] = {}
    for name in REQUIRED:
        for package, version in pins(name).items():
            assert seen.setdefault(package, version) == version, f"{package} in {name}"


@pytest.mark.parametrize("name", sorted(REQUIRED))
def test_locks_cover_what_the_project_asks_for(name):
    locked = pins(name)
    for requirement in map(Requirement, REQUIRED[name]):
        assert requirement.name in locked, f"run `make lock`: {requirement} is not in envs/{name}.txt"
        assert requirement.specifier.contains(locked[requirement.name]), f"run `make lock`: {requirement}"


def test_joint_environments_hold_their_families_and_only_learning_holds_torch():
    workstation, dev = pins("workstation").items(), pins("dev").items()
    for family in set(FAMILIES) - {"learn", "dev"}:
        assert pins(family).items() <= workstation
    assert workstation < dev
    assert [name for name in REQUIRED if "torch" in pins(name)] == ["learn"]


def test_no_file_says_where_packages_come_from():
    for path in [*ENVS.glob("*.txt"), *ENVS.glob("*.yaml")]:
        text = path.read_text()
        found = re.search(
            r"://|\bindex|find-links|trusted-host| @ |^-|(?<!envs)/(tmp|home|root)\b", text, re.M
        )
        assert found is None, f"{path.name}: {found}"


def test_platform_clauses_leave_the_lock_and_others_stay():
    kept = "python_full_version < '3.12'"
    clauses = " and ".join([*lock.PLATFORM, kept])
    assert (
        lock.without_platform(f"numpy==2.4 ; {clauses} \\\n    --hash=x\n")
        == f"numpy==2.4 ; {kept} \\\n    --hash=x\n"
    )
    assert lock.without_platform(f"numpy==2.4 ; {lock.PLATFORM[0]} \\\n") == "numpy==2.4 \\\n"
    either = "numpy==2.4 ; (sys_platform == 'linux' or a == 'b') \\\n"
    assert lock.without_platform(either) == either


# The scripts

_PYTHON = """#!/usr/bin/env bash
echo "python $*" >>"$CALLS"
case "$*" in
"-I -c "*) echo "$STUBS/python3" ;;
"-I - "*) exec {python} "$@" ;;
"-V") echo "Python 3.11.2" ;;
"-m venv "*) mkdir -p "$3/bin" && cp "$STUBS/python3" "$3/bin/python" && cp "$STUBS/uv" "$3/bin/uv" ;;
"-m pip config list") echo "$PIP_SAYS" ;;
"envs/front.py") mkdir -p venv/share/vibraverse && cp front.sum venv/share/vibraverse/front.sha256 ;;
esac
"""
_UV = """#!/usr/bin/env bash
echo "uv $* [$UV_DEFAULT_INDEX] [$UV_INDEX] [$UV_FIND_LINKS]" >>"$CALLS"
if [ -n "${BREAK:-}" ]; then kill -9 $PPID; fi
exit "${UV_STATUS:-0}"
"""
_TOOLS = [
    "bash",
    "cat",
    "cp",
    "cut",
    "dirname",
    "du",
    "env",
    "find",
    "flock",
    "grep",
    "head",
    "ls",
    "mkdir",
    "mktemp",
]
_TOOLS += ["mv", "paste", "realpath", "rm", "sed", "sha256sum", "sort", "tail", "touch", "uname"]


class Sandbox:
    """A copy of the scripts with stand-ins for everything that reaches outside."""

    def __init__(self, folder: Path):
        self.project, self.stubs, self.calls = folder / "project", folder / "stubs", folder / "calls"
        self.stubs.mkdir()
        (self.project / "envs").mkdir(parents=True)
        for name in ("env.sh", "system.sh", "post-deploy.sh", "bootstrap.txt"):
            shutil.copy(ENVS / name, self.project / "envs")
        shutil.copy(ROOT / "pyproject.toml", self.project)
        front = load("front")
        for path in front.SOURCES:
            copy = self.project / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
        (self.project / "front.sum").write_text(front.checksum())
        for name in ("workstation", "dev", "learn"):
            (self.project / "envs" / f"{name}.txt").write_text("numpy==2.4.6 \\\npytest==9.2.0 \\\n")
        self.needs("")
        for tool in _TOOLS:
            (self.stubs / tool).symlink_to(shutil.which(tool))
        self.stub("python3", _PYTHON.format(python=sys.executable))
        self.stub("uv", _UV)
        self.stub("id", "#!/bin/sh\necho 1000\n")

    def stub(self, name: str, text: str) -> None:
        (self.stubs / name).write_text(text)
        (self.stubs / name).chmod(0o755)

    def needs(self, text: str) -> None:
        (self.project / "envs/system.txt").write_text(text)

    def run(self, *command: str, cwd: Path | None = None, **variables: str):
        """Return (exit status, everything printed, the stand-ins' calls)."""
        self.calls.write_text("")
        places = {"PATH": str(self.stubs), "STUBS": str(self.stubs), "CALLS": str(self.calls)}
        done = subprocess.run(
            command, cwd=cwd or self.project, env={"PIP_SAYS": "", **places, **variables},
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        return done.returncode, done.stdout, self.calls.read_text()


@pytest.fixture
def sandbox(tmp_path) -> Sandbox:
    return Sandbox(tmp_path)


ENV = ("envs/env.sh", "venv", "workstation")


def test_an_environment_is_made_once(sandbox):
    status, text, calls = sandbox.run(*ENV)
    assert status == 0, text
    assert "is ready" in text
    assert "-m venv" in calls
    assert "--require-hashes -r envs/bootstrap.txt" in calls
    assert re.search(r"uv pip sync .*--require-hashes .*envs/workstation.txt", calls)
    assert re.search(r"uv pip install .*--no-deps --no-build-isolation --editable \.", calls)
    status, text, calls = sandbox.run(*ENV)
    assert (status, text) == (0, "")
    assert calls.count("\n") == 1, "the second call only looks for missing libraries"


@pytest.mark.parametrize("changed", ["front/three.js", "page/main.js", "style.css"])
def test_an_environment_that_writes_pages_gets_what_they_consist_of(sandbox, changed):
    assert "python envs/front.py" in sandbox.run(*ENV)[2]
    assert "front.py" not in sandbox.run("envs/env.sh", "venv2", "learn")[2]
    assert "front.py" not in sandbox.run(*ENV)[2]
    (sandbox.project / "workflow/vibraverse/report" / changed).write_text("")
    assert "python envs/front.py" in sandbox.run(*ENV)[2]


def test_a_changed_lock_updates_and_keeps_the_environment(sandbox):
    sandbox.run(*ENV)
    with (sandbox.project / "envs/workstation.txt").open("a") as file:
        file.write("scipy==1.17.1 \\\n")
    status, text, calls = sandbox.run(*ENV)
    assert (status, "Installing 3 packages" in text) == (0, True), text
    assert "uv pip sync" in calls
    assert "-m venv" not in calls


@pytest.mark.parametrize("accident", [{"UV_STATUS": "2"}, {"BREAK": "1"}])
def test_a_failed_or_killed_installation_is_made_anew(sandbox, accident):
    status, text, _ = sandbox.run(*ENV, **accident)
    assert status != 0
    assert ("Run the same command again" in text) == ("UV_STATUS" in accident)
    leftover = sandbox.project / "venv/lib/half-written"
    leftover.parent.mkdir()
    leftover.touch()
    status, text, calls = sandbox.run(*ENV)
    assert (status, "-m venv" in calls, leftover.exists()) == (0, True, False), text


def test_the_development_environment_serves_as_the_workstation(sandbox):
    assert sandbox.run("envs/env.sh", "venv", "dev")[0] == 0
    assert "uv" not in sandbox.run(*ENV)[2]
    assert "uv pip sync" in sandbox.run("envs/env.sh", "venv", "learn")[2]


def test_environments_can_be_joined(sandbox):
    status, text, calls = sandbox.run("envs/env.sh", "venv", "learn", "dev")
    assert (status, "Installing 2 packages" in text) == (0, True), text
    assert re.search(r"uv pip sync .*--require-hashes .*envs/learn.txt envs/dev.txt", calls)
    assert "uv" not in sandbox.run("envs/env.sh", "venv", "learn")[2]


def test_a_foreign_folder_is_left_alone(sandbox):
    kept = sandbox.project / "venv/mine"
    kept.parent.mkdir()
    kept.touch()
    status, text, calls = sandbox.run(*ENV)
    assert (status, kept.exists(), "uv" in calls) == (1, True, False)
    assert "was not made by this project" in text


def test_an_unsuitable_python_is_named(sandbox):
    sandbox.stub("python9", '#!/bin/sh\ncase "$1" in -V) echo "Python 9.1.0" ;; *) exit 1 ;; esac\n')
    status, text, _ = sandbox.run(*ENV, PYTHON="python9")
    assert status == 1
    assert text.startswith("Python 3.11 or 3.12 is needed; python9 is Python 9.1.0.")
    assert not (sandbox.project / "venv").exists()


def test_what_pip_is_told_reaches_uv(sandbox):
    says = "global.index-url='https://mirror.example/simple'\nglobal.timeout='60'"
    assert "[https://mirror.example/simple]" in sandbox.run(*ENV, PIP_SAYS=says)[2]


def test_several_places_reach_uv_as_it_takes_them(sandbox):
    """pip separates all by blanks or lines, and shows those as Python would; uv wants commas between folders."""
    says = r"""global.extra-index-url='\nhttps://a.example/simple\nhttps://b.example/simple'
global.find-links='/wheels /more/wheels'"""
    calls = sandbox.run(*ENV, PIP_SAYS=says)[2]
    assert "[] [https://a.example/simple https://b.example/simple] [/wheels,/more/wheels]" in calls


NEEDS = """# a comment
run  library libnothere.so.7 libnothere7
run  library libc.so.6       libc6
test command nobrowser       nobrowser
"""
APT = '#!/bin/sh\necho "apt-get $*" >>"$CALLS"\n'
SYSTEM = ("envs/system.sh", sys.executable)


def test_apt_is_untouched_when_nothing_is_missing(sandbox):
    sandbox.needs("run library libc.so.6 libc6\nrun module ensurepip python3-venv\nrun command bash bash\n")
    sandbox.stub("apt-get", APT)
    assert sandbox.run(*SYSTEM, "run") == (0, "", "")


def test_without_root_the_one_command_is_named(sandbox):
    sandbox.needs(NEEDS)
    sandbox.stub("apt-get", APT)
    sandbox.stub("sudo", "#!/bin/sh\nexit 1\n")
    status, text, calls = sandbox.run(*SYSTEM, "run")
    assert (status, calls) == (1, "")
    assert "libnothere.so.7" in text
    assert "  sudo apt-get install -y --no-install-recommends libnothere7\n" in text
    status, text, calls = sandbox.run(*SYSTEM, "test")
    assert (status, calls, "nobrowser" in text) == (0, "", True), "what only tests want stops nobody"


@pytest.mark.parametrize("through_sudo", [False, True])
def test_missing_libraries_are_installed_where_that_is_allowed(sandbox, through_sudo):
    sandbox.needs(NEEDS)
    sandbox.stub("apt-get", APT)
    if through_sudo:
        sandbox.stub("sudo", '#!/bin/sh\nshift\nexec "$@"\n')
        sandbox.stub("true", "#!/bin/sh\n")
    else:
        sandbox.stub("id", "#!/bin/sh\necho 0\n")
    status, text, calls = sandbox.run(*SYSTEM, "run")
    update, install = calls.splitlines()
    assert update.endswith(" update")
    assert install.endswith(" install -y --no-install-recommends libnothere7")
    assert (status, "Still missing after installing libnothere7: libnothere.so.7." in text) == (1, True)


def test_a_failing_apt_and_a_system_without_apt_say_what_is_needed(sandbox):
    sandbox.needs(NEEDS)
    status, text, _ = sandbox.run(*SYSTEM, "run")
    assert (status, "on Debian: libnothere7" in text) == (1, True)
    sandbox.stub("id", "#!/bin/sh\necho 0\n")
    sandbox.stub("apt-get", "#!/bin/sh\necho 'no such package'\nexit 100\n")
    status, text, _ = sandbox.run(*SYSTEM, "run")
    assert (status, "no such package" in text, "could not install libnothere7" in text) == (1, True, True)


def test_the_list_of_system_needs_is_well_formed():
    rows = [
        line.split() for line in (ENVS / "system.txt").read_text().splitlines() if not line.startswith("#")
    ]
    assert {len(row) for row in rows} == {4}
    assert {row[0] for row in rows} == {"run", "test"}
    assert {row[1] for row in rows} == {"library", "module", "command"}


@pytest.mark.parametrize("where", ["", "workflow/rules"])
def test_conda_environments_get_the_project(sandbox, where):
    inside = sandbox.project / where
    inside.mkdir(parents=True, exist_ok=True)
    (sandbox.stubs / "python").symlink_to(sandbox.stubs / "python3")
    script = sandbox.project / "envs/post-deploy.sh"
    status, text, calls = sandbox.run("bash", str(script), cwd=inside)
    assert status == 0, text
    assert f"--no-deps --no-build-isolation --editable {sandbox.project}\n" in calls
    assert calls.endswith(f"python {sandbox.project}/envs/front.py\n")
    outside = sandbox.stubs
    status, text, _ = sandbox.run("bash", str(script), cwd=outside)
    assert (status, "set VIBRAVERSE_PROJECT" in text) == (1, True)
    assert sandbox.run("bash", str(script), cwd=outside, VIBRAVERSE_PROJECT=str(sandbox.project))[0] == 0


def test_every_conda_environment_of_a_rule_has_the_script():
    rules = "".join(path.read_text() for path in (ROOT / "workflow/rules").glob("*.smk"))
    for name in set(re.findall(r"envs/(\w+)\.yaml", rules)):
        assert (ENVS / f"{name}.yaml").is_file()
        assert (ENVS / f"{name}.post-deploy.sh").resolve() == ENVS / "post-deploy.sh"


def test_make_says_what_it_can_do():
    text = subprocess.run(["make", "--no-print-directory"], cwd=ROOT, capture_output=True, text=True).stdout
    documented = set(re.findall(r"^  make ([\w-]+) ", text, re.M))
    declared = set(re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.M)[1].split())
    assert documented == declared
    assert os.access(ROOT / ".ci/run", os.X_OK)
