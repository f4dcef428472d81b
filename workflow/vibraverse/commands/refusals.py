"""``vibraverse refusals``: list what was refused and why, and retry it."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path

from vibraverse.commands import run_arguments, run_paths, run_solidities, share
from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.readable import unreadable
from vibraverse.contract.refusal import REASONS, read_refusal
from vibraverse.contract.texts import and_more, counted
from vibraverse.dataset.schema import REFUSAL_COLUMNS
from vibraverse.dataset.schema.tables import from_tsv
from vibraverse.flow.chain import Refusals, objects_in, refusals_of
from vibraverse.flow.paths import SOLIDITIES, Paths
from vibraverse.machine import locks
from vibraverse.upkeep.lineage import jobs
from vibraverse.upkeep.rebuild import in_order

#: Refusals that a listing shows per reason.
_SHOWN_REFUSALS = 20


def main(argv: list[str]) -> int:
    """List the refusals; with ``--retry`` delete them, with ``--check`` compare their share with a limit."""
    parser = argparse.ArgumentParser(
        prog="vibraverse refusals",
        parents=[run_arguments()],
        description="List refused objects by reason. An object counts as refused when nothing of it is left.",
    )
    parser.add_argument(
        "--objects", nargs="+", metavar="ID", help="look only at these objects (default: all there are)"
    )
    parser.add_argument(
        "--solidities",
        nargs="+",
        choices=SOLIDITIES,
        help="bodies to expect (default: as configured)",
    )
    parser.add_argument(
        "--retry",
        nargs="*",
        metavar="REASON|ID",
        help="delete the refused products of these reasons or objects (default: all), so that the next run makes them",
    )
    parser.add_argument(
        "--check",
        type=share,
        metavar="SHARE",
        help="exit 1 when more than this share of the objects is refused",
    )
    parser.add_argument(
        "--record", type=Path, metavar="FILE", help="count from this dataset.json, not from the products"
    )
    parser.add_argument(
        "--verdict", type=Path, metavar="FILE", help="write the counts and the outcome here (JSON)"
    )
    chosen = parser.parse_args(argv)

    if chosen.record is not None:
        if chosen.retry is not None:
            parser.error("--retry looks at the products, not at --record")
        state = _recorded(chosen.record)
    else:
        paths = run_paths(chosen)
        solidities = chosen.solidities or run_solidities(chosen)
        found = _scan(paths, chosen.objects, solidities)
        if chosen.retry is not None:
            return _retry(paths, found, chosen.retry)
        rows = [row for object_id, refusals in found.items() for row in refusals.rows(object_id)]
        gone = sum(refusals.is_refused(solidities) for refusals in found.values())
        state = State(len(found), gone, rows)
    print(listing(state), end="")
    accepted = chosen.check is None or state.share <= chosen.check
    if not accepted:
        print(
            f"\nToo much is refused: {state.refused} of {state.objects} objects ({state.share:.0%}), and at most "
            f"{chosen.check:.0%} is accepted (dataset.max_refused_share)."
        )
    if chosen.verdict is not None:
        verdict = {
            "accepted": accepted,
            "objects": state.objects,
            "refused_objects": state.refused,
            "refused_share": state.share,
            "max_refused_share": chosen.check,
            "refusals_by_reason": {reason: len(rows) for reason, rows in state.by_reason().items()},
        }
        products.write_json(chosen.verdict, verdict)
    return 0 if accepted else 1


@dataclass(frozen=True)
class State:
    """The number of objects, the number wholly refused, and the rows of ``refusals.tsv``.

    ``warnings`` counts warnings by kind, if a finished dataset states them.
    """

    objects: int
    refused: int
    rows: list[dict]
    warnings: dict[str, int] = field(default_factory=dict)

    @property
    def share(self) -> float:
        """Share of the objects that are wholly refused."""
        return self.refused / self.objects if self.objects else 0.0

    def by_reason(self) -> dict[str, list[dict]]:
        """Return the rows by reason, most frequent first."""
        groups: dict[str, list[dict]] = {}
        for row in self.rows:
            groups.setdefault(row["reason"], []).append(row)
        return dict(sorted(groups.items(), key=lambda item: (-len(item[1]), item[0])))


def listing(state: State) -> str:
    """Return the refusals as text, grouped by reason."""
    partly = len({row["object"] for row in state.rows}) - state.refused
    lines = [f"{state.refused} of {state.objects} objects refused, {partly} more in part."]
    for reason, rows in state.by_reason().items():
        lines += ["", f"{reason} ({len(rows)}): {REASONS[reason]}"]
        for row in rows[:_SHOWN_REFUSALS]:
            name = f"{row['object']} ({row['solidity']})" if row["solidity"] else row["object"]
            lines.append(f"  {name}, at {row['stage']}: {row['message']}")
            lines += [f"      {row['advice']}"] if row["advice"] else []
        more = and_more(len(rows), _SHOWN_REFUSALS)
        lines += [f"  {words}; dataset/refusals.tsv lists all" for words in more]
    if state.warnings:
        kinds = ", ".join(f"{kind.replace('_', ' ')} ({count})" for kind, count in state.warnings.items())
        lines += ["", f"Warnings: {kinds}; the report lists them."]
    return "\n".join(lines) + "\n"


def _recorded(record: Path) -> State:
    """Return the state from a finished dataset: its ``dataset.json`` and the table beside it."""
    table = record.with_name("refusals.tsv")
    for path in (record, table):
        missing = "finish the run, which makes the dataset"
        if wrong := unreadable(path, missing=missing, folder="name dataset.json in it"):
            raise UsageError(f"{path} {wrong}")
    said = products.read_json(record)
    counts = said["counts"]
    rows = from_tsv(table.read_text(encoding="utf-8"), REFUSAL_COLUMNS)
    objects = counts["objects"] + counts["refused_objects"]
    return State(objects, counts["refused_objects"], rows, said.get("warnings_by_kind", {}))


def _scan(paths: Paths, objects: list[str] | None, solidities) -> dict[str, Refusals]:
    existing = objects_in(paths)
    if not existing:
        raise UsageError(
            f"{paths.results}/objects holds no objects; give the results folder of a run with --results"
        )
    for object_id in objects or ():
        _check_known(object_id, existing, "object")
    return {object_id: refusals_of(paths, object_id, solidities) for object_id in objects or existing}


def _retry(paths: Paths, found: dict[str, Refusals], asked: list[str]) -> int:
    for name in asked:
        _check_known(name, [*REASONS, *found], "reason or object")
    with locks.only_run(paths.results):
        _delete(paths, found, asked)
    return 0


def _delete(paths: Paths, found: dict[str, Refusals], asked: list[str]) -> None:
    refused, touched = [], set()
    for object_id in found:
        for made in jobs(paths, object_id) if any(found[object_id]) else ():
            refusal = read_refusal(made.record)
            if refusal and (not asked or refusal.reason in asked or object_id in asked):
                refused += [place for place in made.places if place.exists()]
                touched.add(object_id)
    for path in in_order(paths, refused, touched) if touched else ():
        products.remove(path)
    if touched:
        print(
            f"Deleted {counted(len(refused), 'refused product')} of {counted(len(touched), 'object')}; "
            "the next run makes them again."
        )
    else:
        print("Nothing to retry.")


def _check_known(name: str, known: list[str], kind: str) -> None:
    if name not in known:
        from vibraverse.contract.texts import unknown

        raise UsageError(unknown(kind, name, known))
