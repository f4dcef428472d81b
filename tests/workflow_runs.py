"""Running the real workflow on a tiny configuration, and reading Snakemake's own plan."""

from __future__ import annotations

import copy
import hashlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import yaml

from vibraverse.contract import journal

#: One small bar, linear elements, few modes: every rule runs, none for long.
TINY = {
    "results": "results",
    "sources": {"generated": {"count": 1, "families": ["bar"]}, "bundled": [], "files": []},
    "materials": {"steel": None, "wood": None},
    "solidities": ["solid", "hollow"],
    "tets": {"target_elements": 1200},
    "basis": {"order": 1, "modes": 12},
    "audio": {"max_s": 0.5},
    "images": {"views": 1, "looks": ["clay"], "size_px": 64},
    "dataset": {"shards": 2},
}


class Run:
    """A folder in which the workflow runs with a configuration that a test may change: a dictionary, or bytes.

    ``python`` is that of the environment in which it runs.
    """

    def __init__(
        self,
        folder: Path,
        root: Path,
        config: dict | None = None,
        profile: str = "default",
        python: str = sys.executable,
    ):
        self.folder, self.root, self.profile, self.python = folder, root, profile, python
        self.config = copy.deepcopy(config or TINY)

    def command(self, *arguments: str) -> list[str]:
        config = self.config if isinstance(self.config, bytes) else yaml.safe_dump(self.config).encode()
        (self.folder / "config.yaml").write_bytes(config)
        return [
            self.python, "-m", "snakemake", "--snakefile", str(self.root / "Snakefile"),
            "--directory", str(self.folder),
            "--workflow-profile", str(self.root / "workflow/profiles" / self.profile),
            *([] if "slurm" in self.profile else ["--cores", "2"]), *arguments,
        ]  # fmt: skip

    @property
    def environment(self) -> dict[str, str]:
        """The environment with the interpreter's commands first, since rules call ``vibraverse``: that of ``root``."""
        path = f"{Path(self.python).parent}{os.pathsep}{os.environ['PATH']}"
        return {**os.environ, "PATH": path, "PYTHONPATH": str(self.root / "workflow")}

    def __call__(self, *arguments: str, check: bool = True) -> subprocess.CompletedProcess:
        done = subprocess.run(
            self.command(*arguments),
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        if check:
            assert done.returncode == 0, done.stdout + done.stderr
        return done

    def start(self, *arguments: str) -> subprocess.Popen:
        """Start the workflow in a process group of its own."""
        return subprocess.Popen(
            self.command(*arguments),
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def at_work(self, after: int = 0) -> Callable[[], bool]:
        """Return a function that tells whether a job works, once ``after`` others of this start have begun."""
        results = self.folder / self.config["results"]
        before = {file for file, _ in journal.begun(results)}
        seen: set[Path] = set()

        def works() -> bool:
            marks = [(file, job) for file, job in journal.begun(results) if file not in before]
            seen.update(file for file, _ in marks)
            return len(seen) > after and any(journal.works(*mark) for mark in marks)

        return works

    def plan(self, *targets: str) -> tuple[dict[str, int], str]:
        """Return the jobs Snakemake would run for the targets, counted by rule, and its whole output."""
        done = self("--dry-run", *targets)
        text = done.stdout + done.stderr
        table = re.search(r"^job +count\n-+ +-+\n(.*?)^total", text, re.MULTILINE | re.DOTALL)
        rows = dict(re.findall(r"^(\w+) +(\d+)$", table[1], re.MULTILINE)) if table else {}
        return {rule: int(count) for rule, count in rows.items()}, text

    def checksums(self) -> dict[str, str]:
        """Return the SHA-256 of every product. Logs, the journal and its excerpt on the page hold times, as do files of
        Snakemake."""
        results = self.folder / self.config["results"]
        return {
            str(path.relative_to(results)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(results.rglob("*"))
            if path.is_file()
            and path.name not in (".snakemake_timestamp", "times.js")
            and path.relative_to(results).parts[0] not in ("logs", "journal", ".run.lock")
        }


def kill_when(process: subprocess.Popen, at_work: Callable[[], bool]) -> bool:
    """Kill a process and its group while ``at_work()`` holds; return whether it ever did.

    The group is suspended during the check, so that the kill hits the working job.
    """
    while process.poll() is None:
        if at_work():
            os.killpg(process.pid, signal.SIGSTOP)
            time.sleep(0.05)  # until all of them do stand still
            if at_work():
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                return True
            os.killpg(process.pid, signal.SIGCONT)
        time.sleep(0.002)
    return False
