"""What training makes of a GPU: one prepared command for a machine that is lent for minutes.

    python benchmarks/gpu.py --minutes 8 [--device cuda] [--features FOLDER] [--out gpu-benchmark]

It measures batched labels and LOBPCG against the CPU, trains models of every task, and with two GPUs compares two
processes with one. FOLDER: see benchmarks/loader.py; without it bodies are invented. The table and results.json in
--out are rewritten after every part. A part that takes longer than its share of the minutes is killed, and what it had
found is kept, so the command ends in time whatever happens.

A machine with PyTorch and no network needs five more packages, 3 MB, which `pip download --no-deps` fetches for it
elsewhere: annotated-types, ocnn, pydantic, pydantic-core (of pydantic's version), scikit-fem. Then `pip install
--no-index --no-deps --target site *.whl` and PYTHONPATH=site:workflow.
"""

from __future__ import annotations

import argparse
import importlib
import json
import multiprocessing
import os
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from vibraverse.machine.threads import set_threads

set_threads(1)

import gpu_parts  # noqa: E402
from gpu_parts import Setting  # noqa: E402

#: Models that are trained, and the weights of the parts in the sharing of time.
_TRAINED = ("frequencies:published", "frequencies:physics", "solidity:published", "solidity:informed")
_WEIGHTS = {"data": 10, "labels": 2, "lobpcg": 3, "loader": 2, "together": 2}
_TRAINING_WEIGHT = 5
#: What the parts import, once for all; an optimiser's first step imports the first. None of them may load the driver,
#: which does not survive a fork; ocnn does.
_IMPORTED = (
    "torch._dynamo", "synthetic", "loader", "vibraverse.learn.launch", "vibraverse.learn.labels",
    "vibraverse.learn.baselines.lobpcg", "vibraverse.learn.tasks.solidity",
)  # fmt: skip
#: Share of its time after which a part should be done, and seconds that it may need to begin.
_AIM, _BEGIN_S = 0.6, 2.0


def main() -> None:
    began = time.monotonic()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cuda")
    parser.add_argument("--features", type=Path)
    parser.add_argument("--objects", type=int, default=320, help="objects that are invented")
    parser.add_argument("--preset", choices=["tiny", "cpu", "small", "paper"], default="small")
    parser.add_argument("--models", nargs="+", default=list(_TRAINED), metavar="TASK:MODEL")
    parser.add_argument("--threads", type=int, default=2, help="of a training")
    parser.add_argument("--out", type=Path, default=Path("gpu-benchmark"))
    arguments = parser.parse_args()
    ends = began + 60 * arguments.minutes - 1.0

    for module in _IMPORTED:
        importlib.import_module(module)
    work = arguments.out / "work"
    work.mkdir(parents=True, exist_ok=True)
    os.environ["OCNN_AUTOTUNE_CACHE_PATH"] = str(work / "ocnn.json")
    features = arguments.features or work / "features"
    parts: dict[str, tuple[Callable, float]] = {}
    if arguments.features is None:
        parts["data"] = (lambda setting: gpu_parts.data(setting, arguments.objects), _WEIGHTS["data"])
    parts |= {
        "labels": (gpu_parts.labels, _WEIGHTS["labels"]),
        "lobpcg": (gpu_parts.lobpcg, _WEIGHTS["lobpcg"]),
    }
    for name in arguments.models:
        parts[f"train {name}"] = (gpu_parts.training(*name.split(":")), _TRAINING_WEIGHT)
    parts |= {
        "loader": (gpu_parts.loader, _WEIGHTS["loader"]),
        "together": (gpu_parts.together, _WEIGHTS["together"]),
    }

    found = {"command": vars(arguments) | {"features": str(features), "out": str(arguments.out)}, "parts": {}}
    waiting = dict(parts)
    for name, (part, weight) in parts.items():
        share = (ends - time.monotonic()) * weight / sum(weight for _, weight in waiting.values())
        del waiting[name]
        aim = max(1.0, _AIM * share - _BEGIN_S)
        setting = Setting(arguments.device, arguments.preset, features, work, aim, arguments.threads)
        found["parts"][name] = _watched(name, part, setting, share)
        found["seconds"] = time.monotonic() - began
        (arguments.out / "results.json").write_text(json.dumps(found, indent=1) + "\n")
        (arguments.out / "table.md").write_text(table(found))
        print(f"{name}: {json.dumps(found['parts'][name])}", flush=True)
    print(f"\n{table(found)}", flush=True)
    if multiprocessing.active_children():
        os._exit(0)  # a regular exit would wait for it


def _watched(name: str, part: Callable, setting: Setting, limit_s: float) -> dict:
    """Run a part in a child process for at most ``limit_s``; return what it found, and how it ended."""
    out = setting.work / f"{name.replace(' ', '-').replace(':', '-')}.json"
    out.unlink(missing_ok=True)
    watch = _watch(setting)
    child = multiprocessing.get_context("fork").Process(target=_child, args=(part, setting, out))
    began = time.monotonic()
    child.start()
    child.join(max(limit_s, 0.1))
    ended = "in time"
    if child.is_alive():
        ended = f"killed after {limit_s:.0f} s"
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.kill()
        child.join(5)  # a driver can keep a process that is killed
    elif child.exitcode:
        ended = f"failed, exit status {child.exitcode}; its error stands above"
    found = json.loads(out.read_text()) if out.is_file() else {}
    return {**found, **_busy(watch), "ended": ended, "took_s": round(time.monotonic() - began, 2)}


def _child(part: Callable, setting: Setting, out: Path) -> None:
    """Write what a part finds after each of its findings."""
    os.setsid()
    found: dict = {}
    for more in part(setting):
        found |= more
        partial = out.with_suffix(".partial")
        partial.write_text(json.dumps(found))
        partial.replace(out)


def _watch(setting: Setting) -> subprocess.Popen | None:
    """Start to note how busy the GPU is, once a second."""
    query = [
        "nvidia-smi",
        "--query-gpu=utilization.gpu,memory.used",
        "--format=csv,noheader,nounits",
        "-l",
        "1",
    ]
    if setting.device == "cpu":
        return None
    with suppress(FileNotFoundError):
        return subprocess.Popen(query, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    return None


def _busy(watch: subprocess.Popen | None) -> dict:
    """Return the mean share of time in which the first GPU worked, without the first seconds, and its most memory."""
    if watch is None:
        return {}
    watch.terminate()
    rows = [line.split(",") for line in watch.communicate()[0].splitlines()]
    rows = [[float(word) for word in row] for row in rows if all(word.strip().isdigit() for word in row)]
    if not rows:
        return {}
    later = rows[min(5, len(rows) - 1) :]
    return {
        "gpu_busy": sum(row[0] for row in later) / len(later) / 100,
        "gpu_mb": max(row[1] for row in rows),
    }


def table(found: dict) -> str:
    """Return what was found as a table for benchmarks/README.md."""
    parts = found["parts"]
    trained = next((part for part in parts.values() if "hardware" in part), None)
    ran = ""
    if trained:
        hardware, versions = trained["hardware"], trained["versions"]
        cpu = f"{hardware['cpu']} ({hardware['cores']} cores)"
        ran = f"{hardware['gpu'] or 'no GPU'}, {cpu}, torch {versions['torch']}, "
    rows = [f"| {name} | {_said(name, part)} | {part['ended']} |" for name, part in parts.items()]
    title = f"{ran}preset `{found['command']['preset']}`, {found['seconds']:.0f} s for all."
    return "\n".join([title, "", "| part | found | ended |", "| --- | --- | --- |", *rows, ""])


def _said(name: str, part: dict) -> str:
    """Return what a part found in words; a part that was killed may lack some."""
    phrases = []
    for phrase in _PHRASES[name.split()[0]] + _OF_THE_GPU:
        with suppress(KeyError):
            phrases.append(phrase.format(**part))
    if name == "loader":
        phrases += [f"{key} {value:,.0f} samples/s" for key, value in part.items() if key.endswith("workers")]
    return "; ".join(phrases)


_PHRASES = {
    "data": ["{bodies} bodies invented"],
    "labels": [
        "{rows} rows, {modes} modes",
        "{device_per_s:,.0f} spectra/s in batches of {batch}, {cpu_per_s:,.0f} on one CPU thread",
        "largest difference {difference:.1e}",
    ],
    "lobpcg": [
        "{unknowns:,} unknowns, {modes} modes, {iterations} iterations in {device_s:.2f} s, converged: {converged}",
        "{device_ms_per_iteration:.1f} ms an iteration, {cpu_ms_per_iteration:.1f} on one CPU thread",
        "the eigensolver {eigensolver_cpu_s:.1f} s on one CPU thread",
        "largest difference {difference:.1e}",
    ],
    "train": [
        "{samples_per_s:,.0f} samples/s",
        "waiting for data {waiting_share:.0%}",
        "{steps:,} steps of {samples[batch]} in {seconds:.0f} s, {precision}",
        "best {validation[metric]} {best_value:.3g}",
        "{own_gpu_mb:,.0f} MB at most",
    ],
    "loader": [],
    "together": [
        "{left_out}",
        "largest difference of a weight {difference_of_weights:.1e}, of the loss {difference_of_loss:.1e}",
    ],
}
_OF_THE_GPU = ["GPU busy {gpu_busy:.0%}, {gpu_mb:,.0f} MB"]


if __name__ == "__main__":
    main()
