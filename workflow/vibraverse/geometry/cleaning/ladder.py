"""The ladder of repairs: its rungs, gentlest first, and how it is climbed.

A rung is a function of the welded soup that returns a surface or raises :class:`Unfit`. The first whose result passes
:func:`judge`, and neither loses nor invents too much of the shape, is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.geometry import LONGEST_SIDE, Mesh, repair, surfaces
from vibraverse.geometry.cleaning.attempt import Attempt, once
from vibraverse.geometry.cleaning.judge import Scattered, Sheet, Unfit, counted, is_solid, judge, without_area
from vibraverse.geometry.cleaning.sheets import thicken
from vibraverse.geometry.cleaning.wrapping import draw_in
from vibraverse.geometry.distance.boxes import contains
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.distance.deviation import Deviation, deviation

#: Points closer than this are joined, in normalised units.
_WELD = 1e-5
#: What a repair leaves apart is a crumb while it holds at most this share of the volume.
_CRUMBS = 0.002
#: A part whose mean thickness 2V/A is below this, in normalised units, is flat.
_FLAT = 1e-5
#: More triangles that cut one another are not resolved exactly: that would take minutes.
_MANY = 3000
#: Bodies that touch in an edge or a point move this far apart, in normalised units.
_APART = 1e-4
#: Wrapping radii and distances from the soup, as shares of the diagonal, coarsest first.
_WRAPS = ((0.04, 0.004), (0.02, 0.003), (0.01, 0.003))
#: A wrap that holds less than this share of a coarser one has entered the body through a hole.
_ENTERED = 0.5
#: A wrap whose mean thickness 2V/A is below this many distances from the soup has nothing inside it.
_SHEET = 3.0
#: What is outside a result may be this far from it, as a share of the diagonal.
_LOST = 0.01
#: This share of a result's area may be made up. A hemisphere's cover is a third of what it closes: a bowl stays a bowl.
_INVENTED = 0.3


@dataclass(frozen=True)
class Climb:
    """Where the ladder ended: the rung, its result, what it did, how far that is from the source, what failed."""

    rung: str
    body: Mesh
    attempt: Attempt
    deviation: Deviation | None
    failed: list[dict[str, str]]


def climb(
    rungs: Sequence[tuple[str, Callable]], soup: Mesh, failed: list[dict[str, str]], **options: float
) -> Climb:
    """Return the first rung's result that is a solid like the soup; ``options`` are those of :class:`Attempt`.

    Failures are appended to ``failed`` as ``{"rung": …, "failed": …}``. Raises :class:`Refused` when no rung is left,
    and :class:`Sheet` as soon as one finds that there is nothing inside.
    """
    from pymeshlab import PyMeshLabException

    last, made = Unfit("no repair to try"), {}
    for name, rung in rungs:
        attempt = Attempt(**options, made=made)
        try:
            body = rung(*soup, attempt)
            judge(*body)
            away = None if rung is as_it_is else _compare(soup, body, attempt, rung)
        except PyMeshLabException as error:
            last = Unfit(f"MeshLab: {str(error).splitlines()[-1].strip()}")
        except Sheet as sheet:
            failed.append({"rung": name, "failed": str(sheet)})
            raise
        except Unfit as unfit:
            last = unfit
        else:
            return Climb(name, body, attempt, away, failed)
        failed.append({"rung": name, "failed": str(last)})
    said = "; ".join(f"{entry['rung']}: {entry['failed']}" for entry in failed)
    raise Refused(last.reason, f"No repair made the surface that of one solid. {said}.", last.advice)


def _compare(soup: Mesh, body: Mesh, attempt: Attempt, rung: Callable) -> Deviation:
    """Return how far a result is from the soup; raise :class:`Unfit` when that is too far."""
    # Crumbs may go because they are small, not because they are light: only what is dropped on purpose is not missed.
    away = deviation(soup, body, attempt.dropped if rung in _DROPPING else [])
    if away.source_to_body > _LOST:
        raise Unfit(f"a part of the source lost, {100 * away.source_to_body:.1f} % of the diagonal away")
    if away.invented > _INVENTED and rung not in _THICKENING:
        raise Unfit(f"{100 * away.invented:.0f} % of the surface would be made up")
    return away


def as_it_is(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Keep every triangle; turn those that point the wrong way."""
    turned = repair.orient(vertices, faces)
    count = int((turned != faces).any(axis=1).sum())
    if count:
        attempt.notes.append(f"turned {counted(count, 'triangle')}")
    return vertices, turned


def weld(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Join points that are almost equal."""
    joined, kept = repair.weld(vertices, faces, _WELD)
    kept = repair.drop_doubles(kept)
    if len(kept) < len(faces) or len(joined) < len(vertices):
        points, triangles = len(vertices) - len(joined), len(faces) - len(kept)
        attempt.notes.append(f"joined {counted(points, 'point')}, dropped {counted(triangles, 'triangle')}")
    return as_it_is(joined, kept, attempt)


def close(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Close the holes of a surface of one part."""
    bodies = _closed_parts(vertices, faces, attempt)
    if len(bodies) > 1:
        raise Unfit(counted(len(bodies) - 1, "further part"))
    return bodies[0]


def unite(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Close the holes of every part and take what they enclose together as one body."""
    return _largest(_bodies(vertices, faces, attempt), attempt, _CRUMBS)


def wrap(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Shrink-wrap everything, as finely as the holes allow."""
    return _wrapped(vertices, faces, attempt, _CRUMBS)


def largest(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Of bodies that lie apart, each united from its parts, keep the largest."""
    return _largest(_bodies(vertices, faces, attempt), attempt, attempt.max_dropped)


def largest_wrap(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Of wraps that lie apart keep the largest."""
    return _wrapped(vertices, faces, attempt, attempt.max_dropped)


def thickened(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Give sheets a thickness by moving both sides out, and unite them."""
    plates = []
    for part in repair.parts(*weld(vertices, faces, attempt)):
        if surfaces.topology(part[1], len(part[0])).disagreeing_edges:
            raise Unfit("a sheet with one side only")
        plates.append(thicken(*part, attempt.thickness))
    share = f"{100 * attempt.thickness / LONGEST_SIDE:g} % of the longest side"
    attempt.notes.append(f"thickened {counted(len(plates), 'sheet')} to {share}")
    if len(plates) == 1 and is_solid(*plates[0]):
        return plates[0]
    return _largest(_united(plates, attempt), attempt, attempt.max_dropped)


def thickly_wrapped(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Give sheets a thickness by wrapping them at half of it."""
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    offset = 0.5 * attempt.thickness / diagonal
    wrapped = repair.wrap(vertices, faces, max(offset, 0.01), offset)
    attempt.notes.append(f"wrapped at {50 * attempt.thickness / LONGEST_SIDE:g} % of the longest side")
    return _largest(surfaces.components(*wrapped), attempt, attempt.max_dropped)


#: The ladder, gentlest first: name -> function of the soup that notes what it did and may raise Unfit.
RUNGS: tuple[tuple[str, Callable], ...] = (
    ("as-is", as_it_is),
    ("weld", weld),
    ("close", close),
    ("unite", unite),
    ("wrap", wrap),
    ("largest", largest),
    ("largest-wrap", largest_wrap),
)
#: The ladder for open sheets that are to be thickened.
SHEET_RUNGS: tuple[tuple[str, Callable], ...] = (("thicken", thickened), ("thick-wrap", thickly_wrapped))
#: Rungs that drop bodies on purpose, and those that make a body of what is none.
_DROPPING = (largest, largest_wrap, thickened, thickly_wrapped)
_THICKENING = (thickened, thickly_wrapped)


@once
def _bodies(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> list[Mesh]:
    """Return the bodies that the parts of a soup, each closed, enclose together."""
    return _united(_closed_parts(vertices, faces, attempt), attempt)


@once
def _wraps(
    vertices: np.ndarray, faces: np.ndarray, attempt: Attempt, alpha: float, offset: float
) -> list[Mesh]:
    """Return the shells of a wrap."""
    return surfaces.components(*repair.wrap(vertices, faces, alpha, offset))


@once
def _closed_parts(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> list[Mesh]:
    """Return every part with its holes closed, facing outward; parts that then enclose nothing are left out."""
    bodies, inward, closed, flat = [], [], 0, 0
    vertices, faces = repair.weld(vertices, faces, _WELD)
    for points, loose in repair.parts(vertices, repair.drop_doubles(faces)):
        part = points, repair.orient(points, loose)
        turned = bool((part[1] != loose).any(axis=1).mean() > 0.5)
        if surfaces.topology(part[1], len(points)).open_edges:
            part = repair.close_holes(*part)
            closed += 1
        part = _capless(*repair.separate(*part, _APART))
        found, enclosed = surfaces.topology(part[1], len(part[0])), surfaces.volume(*part)
        if not found.closed_manifold or 2 * abs(enclosed) < _FLAT * surfaces.area(*part):
            flat += 1
            continue
        if enclosed < 0:
            part, turned = (part[0], part[1][:, ::-1]), not turned
        bodies.append(part)
        inward.append(turned)
    if not bodies:
        raise Unfit(f"{counted(flat, 'part')} without a volume")
    if closed:
        attempt.notes.append(f"closed the holes of {closed} of {counted(len(bodies) + flat, 'part')}")
    if flat:
        attempt.notes.append(f"left out {counted(flat, 'flat part')}")
    attempt.filled_cavities += _cavities(bodies, inward)
    return bodies


def _capless(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Return a surface without triangles that have no area, where it is closed."""
    if not surfaces.topology(faces, len(vertices)).closed_manifold or not without_area(vertices, faces).any():
        return vertices, faces
    return repair.flip_caps(vertices, faces)


def _cavities(bodies: list[Mesh], inward: list[bool]) -> int:
    """Return how many of the bodies lie inside another that faced the other way."""
    boxes = [(points.min(axis=0), points.max(axis=0)) for points, _ in bodies]
    count = 0
    for i, (points, _) in enumerate(bodies):
        for j, other in enumerate(bodies):
            within = (boxes[i][0] > boxes[j][0]).all() and (boxes[i][1] < boxes[j][1]).all()
            if within and inward[i] != inward[j] and contains(*other, points).all():
                count += 1
                break
    return count


def _united(bodies: list[Mesh], attempt: Attempt) -> list[Mesh]:
    """Return the bodies that closed surfaces enclose together, each with its own surface, holes inside filled."""
    solids, crossings = [], 0
    for body in bodies:
        crossing = int(crossing_faces(*body).sum())
        solids += _resolved(body, crossing, attempt) if crossing else [body]
        crossings += crossing
    if crossings:
        attempt.notes.append(f"resolved {counted(crossings, 'triangle')} that cut or touch each other")
    pieces = [_tidied(*solid) for solid in solids]
    if len(solids) > 1:
        pieces = _joined(solids, attempt)
    if len(bodies) > 1:
        attempt.notes.append(f"united {counted(len(bodies), 'part')}, which left {len(pieces)}")
    return pieces


def _joined(solids: list[Mesh], attempt: Attempt) -> list[Mesh]:
    """Return the union of bodies none of which cuts itself."""
    try:
        pieces = [_tidied(*piece) for piece in _shells(*repair.join(solids), attempt)]
        if all(is_solid(*piece) for piece in pieces):
            return pieces
    except ValueError:
        pass
    together = surfaces.joined(solids)
    crossing = int(crossing_faces(*together).sum())
    return [_tidied(*piece) for piece in _resolved(together, crossing, attempt)]


def _resolved(body: Mesh, crossing: int, attempt: Attempt) -> list[Mesh]:
    """Return the bodies inside a closed surface of which ``crossing`` faces cut or touch others."""
    if crossing > _MANY:
        raise Unfit(f"{crossing} triangles that cut or touch each other, too many to resolve")
    try:
        return _shells(*repair.unite(*body), attempt)
    except ValueError as error:
        raise Unfit(f"parts that are not closed ({error})") from None


def _shells(points: np.ndarray, triangles: np.ndarray, attempt: Attempt) -> list[Mesh]:
    """Return the bodies of a union, taken apart where they touch; shells facing inwards are left out and counted."""
    points, triangles = repair.weld(points, triangles)
    shells = surfaces.components(*repair.separate(points, triangles, _APART))
    volumes = [surfaces.volume(*shell) for shell in shells]
    attempt.filled_cavities += sum(volume < -_FLAT * max(volumes) for volume in volumes)
    return [shell for shell, volume in zip(shells, volumes, strict=True) if volume > 0]


def _tidied(points: np.ndarray, triangles: np.ndarray) -> Mesh:
    """Return a body without the slivers that cutting leaves, where it is a solid without them."""
    try:
        smooth = repair.simplify(points, triangles, _WELD)
    except ValueError:
        return points, triangles
    return smooth if is_solid(*smooth) else (points, triangles)


def _wrapped(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt, may_drop: float) -> Mesh:
    """Return the finest wrap that has not entered the body; raise :class:`Sheet` when nothing is inside it."""
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    enclosed, best, complaint = 0.0, None, Unfit("nothing to wrap")
    for alpha, offset in _WRAPS:
        trial = Attempt()
        try:
            wrapped = _largest(_wraps(vertices, faces, attempt, alpha, offset), trial, may_drop)
            inside = surfaces.volume(*wrapped)
            if inside < _ENTERED * enclosed:
                break
            judge(*wrapped)
        except Scattered as scattered:  # and more so where it enters narrower gaps
            complaint = scattered
            break
        except Unfit as unfit:
            complaint = unfit
            continue
        enclosed = max(enclosed, inside)
        body = draw_in(*wrapped, offset * diagonal, (vertices, faces))
        thickness = 2 * surfaces.volume(*body) / surfaces.area(*body)
        trial.notes.insert(0, f"wrapped at {100 * alpha:g} % of the diagonal")
        if thickness < _SHEET * offset * diagonal:
            complaint = Sheet("a wrap around it has nothing inside")
            break
        best = body, trial
    if best is None or isinstance(complaint, Sheet):
        raise complaint
    body, trial = best
    attempt.notes += trial.notes
    attempt.dropped, attempt.dropped_share = trial.dropped, trial.dropped_share
    return body


def _largest(pieces: list[Mesh], attempt: Attempt, may_drop: float) -> Mesh:
    """Return the largest piece; raise :class:`Scattered` when the others hold more than they may."""
    volumes = np.array([surfaces.volume(*piece) for piece in pieces])
    if not len(volumes) or volumes.max() <= 0:
        raise Unfit("nothing is left")
    keep = int(volumes.argmax())
    volumes = volumes.clip(0)
    share = float(1 - volumes[keep] / volumes.sum())
    others = len(pieces) - 1
    if share > may_drop + 1e-9:
        raise Scattered(
            f"{counted(others, 'further body')} with {100 * share:.3g} % of the volume apart from the largest"
            + (f"; at most {100 * may_drop:g} % may be dropped" if may_drop > _CRUMBS else "")
        )
    if others:
        attempt.notes.append(f"dropped {counted(others, 'body')} with {100 * share:.2g} % of the volume")
        attempt.dropped = [piece for i, piece in enumerate(pieces) if i != keep]
        attempt.dropped_share = share
    return pieces[keep]
