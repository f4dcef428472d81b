"""``vibraverse refusals``: what was refused and why, and making it run again."""

from __future__ import annotations

import argparse
from pathlib import Path

from vibraverse.cli import UsageError
from vibraverse.dataset.chain import Refusals, objects_in, refusals_of
from vibraverse.paths import SOLIDITIES, Paths
from vibraverse.refusal import REASONS, read_refusal


def main(argv: list[str]) -> int:
    """List the refusals; with ``--retry`` delete them, with ``--check`` judge their share."""
    parser = argparse.ArgumentParser(
        prog="vibraverse refusals",
        description="List refused objects by reason. An object counts as refused when nothing of it is left.",
    )
    parser.add_argument(
        "--results", default="results", metavar="DIR", help="folder of all products (default results)"
    )
    parser.add_argument(
        "--objects", nargs="+", metavar="ID", help="look only at these objects (default: all there are)"
    )
    parser.add_argument(
        "--solidities",
        nargs="+",
        choices=SOLIDITIES,
        default=SOLIDITIES,
        help="bodies to expect (default: both)",
    )
    parser.add_argument(
        "--retry",
        nargs="*",
        metavar="REASON|ID",
        help="delete the refused products of these reasons or objects (default: all), so that the next run makes them",
    )
    parser.add_argument(
        "--check",
        type=_share,
        metavar="SHARE",
        help="exit 1 when more than this share of the objects is refused",
    )
    chosen = parser.parse_args(argv)

    paths = Paths(chosen.results)
    existing = objects_in(paths)
    if not existing:
        raise UsageError(
            f"there are no objects in {chosen.results}/objects; is --results the folder of a run?"
        )
    objects = chosen.objects or existing
    for object_id in objects:
        _known(object_id, existing, "object")
    found = {object_id: refusals_of(paths, object_id, chosen.solidities) for object_id in objects}
    if chosen.retry is not None:
        return _retry(paths, found, chosen.retry)
    print(listing(found, chosen.solidities), end="")
    return 0 if chosen.check is None else _check(found, chosen.solidities, chosen.check)


def listing(found: dict[str, Refusals], solidities=SOLIDITIES) -> str:
    """Return the refusals as text, grouped by reason, most frequent first."""
    by_reason: dict[str, list[dict]] = {}
    for object_id, refusals in found.items():
        for row in refusals.rows(object_id):
            by_reason.setdefault(row["reason"], []).append(row)
    gone = sum(refusals.is_refused(solidities) for refusals in found.values())
    partly = sum(bool(refusals.bodies) for refusals in found.values() if not refusals.is_refused(solidities))
    lines = [f"{gone} of {len(found)} objects refused, {partly} more in part."]
    for reason, rows in sorted(by_reason.items(), key=lambda item: (-len(item[1]), item[0])):
        lines += ["", f"{reason} ({len(rows)}): {REASONS[reason]}"]
        for row in rows:
            name = f"{row['object']} ({row['solidity']})" if row["solidity"] else row["object"]
            lines.append(f"  {name}, at {row['stage']}: {row['message']}")
            lines += [f"      {row['advice']}"] if row["advice"] else []
    return "\n".join(lines) + "\n"


def _retry(paths: Paths, found: dict[str, Refusals], asked: list[str]) -> int:
    for name in asked:
        _known(name, [*REASONS, *found], "reason or object")
    deleted, touched = 0, set()
    for object_id in found:
        folder = Path(paths.at(paths.object, object=object_id))
        for path in sorted(folder.rglob("*")) if any(found[object_id]) else ():
            refusal = read_refusal(path)
            if refusal and (not asked or refusal.reason in asked or object_id in asked):
                path.unlink()
                deleted += 1
                touched.add(object_id)
    if touched:
        print(f"Deleted {deleted} refused products of {len(touched)} objects; the next run makes them again.")
    else:
        print("Nothing to retry.")
    return 0


def _check(found: dict[str, Refusals], solidities, limit: float) -> int:
    gone = sum(refusals.is_refused(solidities) for refusals in found.values())
    share = gone / len(found)
    if share <= limit:
        return 0
    print(
        f"\nToo much is refused: {gone} of {len(found)} objects ({share:.0%}), and at most {limit:.0%} is accepted "
        "(dataset.max_refused_share)."
    )
    return 1


def _share(text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        share = -1.0
    if not 0 <= share <= 1:
        raise argparse.ArgumentTypeError(f"a share lies between 0 and 1, not {text!r}")
    return share


def _known(name: str, known: list[str], kind: str) -> None:
    if name not in known:
        from vibraverse.config import unknown

        shown = known if len(known) <= 20 else [*known[:19], f"and {len(known) - 19} more"]
        raise UsageError(unknown(kind, name, shown))
