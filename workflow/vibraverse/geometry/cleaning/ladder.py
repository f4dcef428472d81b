"""The ladder of repairs: its rungs, gentlest first, and how it is climbed.

A rung is a function of the welded soup that returns a surface or raises :class:`Unfit`. The climb ends at the first
rung whose result passes :func:`judge` and neither loses nor invents too much of the shape.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vibraverse.geometry import LONGEST_SIDE, Mesh, repair, surfaces
from vibraverse.geometry.cleaning.attempt import Attempt, cached
from vibraverse.geometry.cleaning.judge import Scattered, Sheet, Unfit, counted, is_solid, judge, without_area
from vibraverse.geometry.cleaning.sheets import thicken
from vibraverse.geometry.cleaning.sifting import MAX_COVER, MIN_THICKNESS, WELD_DISTANCE
from vibraverse.geometry.cleaning.wrapping import draw_in, holds
from vibraverse.geometry.distance.boxes import contains
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.distance.deviation import Deviation, deviation

#: Separate pieces that hold at most this share of the volume are crumbs.
_MAX_CRUMB_SHARE = 0.002
#: Most crossing triangles that are resolved exactly; more would take minutes.
_MAX_CROSSINGS = 3000
#: Bodies that touch in an edge or a point move this far apart; in normalised units.
_SEPARATION = 1e-4
#: Wrap radii and distances from the soup, as shares of the diagonal, coarsest first.
_WRAP_SIZES = ((0.04, 0.004), (0.02, 0.003), (0.01, 0.003))
#: A wrap with less than this share of a coarser one's volume has entered the body through a hole.
_MIN_WRAP_SHARE = 0.5
#: A wrap whose mean thickness 2V/A is below this many of its distances has nothing inside.
_MIN_WRAP_THICKNESS = 3.0
#: Largest distance from a point of the source to the result, as a share of the diagonal.
_MAX_LOST = 0.01
#: Share of a result's area that may be invented. The cover of a hemisphere is a third of the closed surface's area, so
#: a bowl stays a bowl.
_MAX_INVENTED = MAX_COVER


@dataclass(frozen=True)
class Climb:
    """The end of a climb: the soup, the rung, its result and notes, and the deviation from the soup, if any."""

    soup: Mesh
    rung: str
    body: Mesh
    attempt: Attempt
    deviation: Deviation | None


def climb(
    rungs: Sequence[tuple[str, Callable]],
    soup: Mesh,
    failed: list[dict[str, str]],
    cache: dict,
    encloses: bool = False,
    **options: float,
) -> Climb:
    """Return the result of the first rung that makes a solid like the soup.

    ``options`` are those of :class:`Attempt`, and so is ``cache``, which several climbs over one soup share. Failures
    are appended to ``failed`` as ``{"rung": …, "failed": …}``. Raises the last rung's :class:`Unfit` when no rung is
    left, and :class:`Sheet` as soon as a rung finds that nothing is inside, unless the soup ``encloses`` something.
    """
    from pymeshlab import PyMeshLabException

    last = Unfit("no repair to try")
    for name, rung in rungs:
        attempt = Attempt(**options, cache=cache)
        try:
            body = rung(*soup, attempt)
            judge(*body)
            away = None if rung is as_it_is else _compare(soup, body, attempt, rung)
        except PyMeshLabException as error:
            last = Unfit(f"MeshLab: {str(error).splitlines()[-1].strip()}")
        except Unfit as unfit:
            last = unfit
        else:
            return Climb(soup, name, body, attempt, away)
        failed.append({"rung": name, "failed": str(last)})
        if isinstance(last, Sheet) and not encloses:
            break
    raise last


def _compare(soup: Mesh, body: Mesh, attempt: Attempt, rung: Callable) -> Deviation:
    """Return the deviation of a result from the soup; raises :class:`Unfit` if it is too large."""
    # Crumbs count as lost if they are long, however light. Only bodies dropped on purpose are left out here.
    away = deviation(soup, body, attempt.dropped if rung in _DROPPING_RUNGS else [])
    if away.source_to_body > _MAX_LOST:
        raise Unfit(f"a part of the source lost, {100 * away.source_to_body:.1f} % of the diagonal away")
    if away.invented > _MAX_INVENTED and rung not in _THICKENING_RUNGS:
        raise Unfit(f"{100 * away.invented:.0f} % of the surface would be made up")
    return away


def as_it_is(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Keep every triangle; flip those that face the wrong way."""
    turned = repair.orient(vertices, faces)
    count = int((turned != faces).any(axis=1).sum())
    if count:
        attempt.notes.append(f"turned {counted(count, 'triangle')}")
    return vertices, turned


def weld(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Merge points that are almost equal."""
    joined, kept = repair.weld(vertices, faces, WELD_DISTANCE)
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
    """Close the holes of every part and unite the parts to one body."""
    return _largest(_bodies(vertices, faces, attempt), attempt, _MAX_CRUMB_SHARE)


def wrap(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Shrink-wrap everything, as finely as the holes allow."""
    return _noting_joined(vertices, faces, attempt, _wrapped(vertices, faces, attempt, _MAX_CRUMB_SHARE))


def largest(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Keep the largest of separate bodies, each united from its parts."""
    return _largest(_bodies(vertices, faces, attempt), attempt, attempt.max_dropped)


def largest_wrap(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Keep the largest of separate wraps."""
    return _noting_joined(vertices, faces, attempt, _wrapped(vertices, faces, attempt, attempt.max_dropped))


def thickened(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> Mesh:
    """Thicken sheets by moving both sides out, and unite them."""
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
    """Thicken sheets by wrapping them at half the thickness."""
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    offset = 0.5 * attempt.thickness / diagonal
    wrapped = repair.wrap(vertices, faces, max(offset, 0.01), offset)
    attempt.notes.append(f"wrapped at {50 * attempt.thickness / LONGEST_SIDE:g} % of the longest side")
    return _largest(surfaces.components(*wrapped), attempt, attempt.max_dropped)


#: The rungs that keep bodies apart, gentlest first: name -> function of the soup, which notes its changes and may raise
#: Unfit. What they cannot mend may be due to parts that enclose nothing.
GENTLE_RUNGS: tuple[tuple[str, Callable], ...] = (
    ("as-is", as_it_is),
    ("weld", weld),
    ("close", close),
    ("unite", unite),
)
#: The rungs above.
SEVERE_RUNGS: tuple[tuple[str, Callable], ...] = (
    ("wrap", wrap),
    ("largest", largest),
    ("largest-wrap", largest_wrap),
)
RUNGS = GENTLE_RUNGS + SEVERE_RUNGS
#: The ladder for open sheets that should be thickened.
SHEET_RUNGS: tuple[tuple[str, Callable], ...] = (("thicken", thickened), ("thick-wrap", thickly_wrapped))
#: Rungs that drop bodies on purpose, and rungs that make a body of an open sheet.
_DROPPING_RUNGS = (largest, largest_wrap, thickened, thickly_wrapped)
_THICKENING_RUNGS = (thickened, thickly_wrapped)


@cached
def _bodies(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> list[Mesh]:
    """Return the union of the closed parts of a soup, as separate bodies."""
    return _united(_closed_parts(vertices, faces, attempt), attempt)


@cached
def _wraps(
    vertices: np.ndarray, faces: np.ndarray, attempt: Attempt, alpha: float, offset: float
) -> list[Mesh]:
    """Return the shells of a wrap."""
    return surfaces.components(*repair.wrap(vertices, faces, alpha, offset))


@cached
def _closed_parts(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt) -> list[Mesh]:
    """Return every part with its holes closed, facing outward, without the parts that enclose nothing."""
    bodies, inward, closed, flat = [], [], 0, 0
    vertices, faces = repair.weld(vertices, faces, WELD_DISTANCE)
    for points, loose in repair.parts(vertices, repair.drop_doubles(faces)):
        part = points, repair.orient(points, loose)
        turned = bool((part[1] != loose).any(axis=1).mean() > 0.5)
        if surfaces.topology(part[1], len(points)).open_edges:
            part = repair.close_holes(*part)
            closed += 1
        part = _capless(*repair.separate(*part, _SEPARATION))
        found, enclosed = surfaces.topology(part[1], len(part[0])), surfaces.volume(*part)
        if not found.closed_manifold or 2 * abs(enclosed) < MIN_THICKNESS * surfaces.area(*part):
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
    """Return a surface without caps, if it is closed."""
    if not surfaces.topology(faces, len(vertices)).closed_manifold or not without_area(vertices, faces).any():
        return vertices, faces
    return repair.flip_caps(vertices, faces)


def _cavities(bodies: list[Mesh], inward: list[bool]) -> int:
    """Count the bodies that lie inside another one of opposite orientation."""
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
    """Return the union of closed surfaces as separate bodies, with inner cavities filled."""
    solids, crossings = [], 0
    for body in bodies:
        crossing = int(crossing_faces(*body).sum())
        solids += _resolved(body, crossing, attempt) if crossing else [body]
        crossings += crossing
    if crossings:
        attempt.notes.append(f"resolved {counted(crossings, 'triangle')} that cut or touch each other")
    pieces = [_without_slivers(*solid) for solid in solids]
    if len(solids) > 1:
        pieces = _joined(solids, attempt)
    if len(bodies) > 1:
        attempt.notes.append(f"united {counted(len(bodies), 'part')}, which left {len(pieces)}")
    return pieces


def _joined(solids: list[Mesh], attempt: Attempt) -> list[Mesh]:
    """Return the union of bodies without self-intersections."""
    try:
        pieces = [_without_slivers(*piece) for piece in _shells(*repair.join(solids), attempt)]
        if all(is_solid(*piece) for piece in pieces):
            return pieces
    except ValueError:
        pass
    together = surfaces.joined(solids)
    crossing = int(crossing_faces(*together).sum())
    return [_without_slivers(*piece) for piece in _resolved(together, crossing, attempt)]


def _resolved(body: Mesh, crossing: int, attempt: Attempt) -> list[Mesh]:
    """Return the bodies inside a closed surface that has ``crossing`` faces which cut or touch others."""
    if crossing > _MAX_CROSSINGS:
        raise Unfit(f"{crossing} triangles that cut or touch each other, too many to resolve")
    try:
        return _shells(*repair.unite(*body), attempt)
    except ValueError as error:
        raise Unfit(f"parts that are not closed ({error})") from None


def _shells(points: np.ndarray, triangles: np.ndarray, attempt: Attempt) -> list[Mesh]:
    """Return the bodies of a union, separated where they touch; shells facing inwards are counted and dropped."""
    points, triangles = repair.weld(points, triangles)
    shells = surfaces.components(*repair.separate(points, triangles, _SEPARATION))
    volumes = [surfaces.volume(*shell) for shell in shells]
    attempt.filled_cavities += sum(volume < -MIN_THICKNESS * max(volumes) for volume in volumes)
    return [shell for shell, volume in zip(shells, volumes, strict=True) if volume > 0]


def _without_slivers(points: np.ndarray, triangles: np.ndarray) -> Mesh:
    """Return a body without the slivers that cutting leaves, if it stays a solid."""
    try:
        smooth = repair.simplify(points, triangles, WELD_DISTANCE)
    except ValueError:
        return points, triangles
    return smooth if is_solid(*smooth) else (points, triangles)


def _wrapped(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt, may_drop: float) -> Mesh:
    """Return the finest wrap that has not entered the body; raises :class:`Sheet` if nothing is inside."""
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    enclosed, best, complaint = 0.0, None, Unfit("nothing to wrap")
    for alpha, offset in _WRAP_SIZES:
        trial = Attempt()
        try:
            wrapped = _largest(_wraps(vertices, faces, attempt, alpha, offset), trial, may_drop)
            inside = surfaces.volume(*wrapped)
            if inside < _MIN_WRAP_SHARE * enclosed:
                break
            judge(*wrapped)
        except Scattered as scattered:  # finer wraps enter narrower gaps and scatter more
            complaint = scattered
            break
        except Unfit as unfit:
            complaint = unfit
            continue
        enclosed = max(enclosed, inside)
        body = draw_in(*wrapped, offset * diagonal, (vertices, faces))
        thickness = 2 * surfaces.volume(*body) / surfaces.area(*body)
        trial.notes.insert(0, f"wrapped at {100 * alpha:g} % of the diagonal")
        if thickness < _MIN_WRAP_THICKNESS * offset * diagonal:
            complaint = Sheet("a wrap around it has nothing inside")
            break
        best = body, trial
    if best is None or isinstance(complaint, Sheet):
        raise complaint
    body, trial = best
    attempt.notes += trial.notes
    attempt.dropped, attempt.dropped_share = trial.dropped, trial.dropped_share
    return body


def _noting_joined(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt, body: Mesh) -> Mesh:
    """Return a wrap, noting how many separate bodies it joins.

    Raises :class:`Unfit` if that changes their volume by more than the share ``max_joined``.
    """
    try:
        pieces = _bodies(vertices, faces, Attempt(cache=attempt.cache))
    except Unfit:  # parts that cannot be told apart
        return body
    volumes = np.array([surfaces.volume(*piece) for piece in pieces if holds(body, piece, _MAX_LOST)])
    count = int((volumes > _MAX_CRUMB_SHARE * volumes.sum()).sum())
    if count < 2:
        return body
    change = surfaces.volume(*body) / float(volumes.sum()) - 1
    bodies = f"{count} bodies that lie apart"
    if abs(change) > attempt.max_joined:
        raise Scattered(
            f"joining {bodies} would change their volume by {100 * change:+.3g} %; "
            f"at most {100 * attempt.max_joined:g} % are allowed"
        )
    attempt.notes.append(f"joined {bodies}, which changed their volume by {100 * change:+.2g} %")
    attempt.joined, attempt.joined_growth = count, change
    return body


def _largest(pieces: list[Mesh], attempt: Attempt, may_drop: float) -> Mesh:
    """Return the largest piece; raises :class:`Scattered` if the others hold more than the share ``may_drop``."""
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
            + (f"; at most {100 * may_drop:g} % may be dropped" if may_drop > _MAX_CRUMB_SHARE else "")
        )
    if others:
        attempt.notes.append(f"dropped {counted(others, 'body')} with {100 * share:.2g} % of the volume")
        attempt.dropped = [piece for i, piece in enumerate(pieces) if i != keep]
        attempt.dropped_share = share
    return pieces[keep]
