"""The family tree of a co-design run: bodies by generation, joined to their parents."""

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape

from evogymcm.algos.runs.record import Row, RunRecord
from evogymcm.body import Body
from evogymcm.report.pictures import body_shapes

MOST = 8  # bodies shown of a generation, ancestors of the best besides
_ACROSS, _DOWN, _SIZE, _LEFT = 78, 104, 46, 92  # pixels: pitch, size of a picture, room for the generation's number
_PLAIN, _LINE = "#b4bac2", "#c0392b"


def ancestors(individuals: Mapping[int, Row], index: int) -> list[int]:
    """Returns an individual's line, itself first, as far back as it is known."""
    line = [index]
    while True:
        parent = individuals[line[-1]].get("parent")
        if parent is None or parent not in individuals or parent in line:
            return line
        line.append(parent)


def shown_by_generation(run: RunRecord, line: Sequence[int]) -> dict[int, list[Row]]:
    """Returns which individuals to show of each generation, best first: some of the best, and all of the line."""
    groups: dict[int, list[Row]] = {}
    for row in run.ranked():
        group = groups.setdefault(int(row.get("generation") or 0), [])
        if len(group) < MOST or row["index"] in line:
            group.append(row)
    return dict(sorted(groups.items()))


def lineage_svg(run: RunRecord) -> str:
    """Returns the tree as SVG; the line of the best individual is marked."""
    best = run.ranked()[0]
    line = ancestors(run.designs, best["index"])
    shown = shown_by_generation(run, line)
    totals = Counter(int(row.get("generation") or 0) for row in run.ranked())
    places = {
        row["index"]: (_LEFT + _ACROSS * column, _DOWN * at)
        for at, group in enumerate(shown.values())
        for column, row in enumerate(group)
    }
    links, bodies = [], []
    for at, (generation, group) in enumerate(shown.items()):
        bodies.append(_generation(generation, at, totals[generation] - len(group)))
        for row in group:
            is_line = row["index"] in line
            if row.get("parent") in places:
                links.append((is_line, _link(places[row["parent"]], places[row["index"]], is_line)))
            bodies.append(_individual(row, places[row["index"]], is_line, is_best=row is best))
    drawn = "".join(link for _, link in sorted(links, key=lambda link: link[0]))  # the marked line on top
    width = _LEFT + _ACROSS * max(map(len, shown.values()))
    height = _DOWN * len(shown)
    title = f"bodies of {run.name} by generation"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
        f' role="img"><title>{escape(title)}</title>{drawn}{"".join(bodies)}</svg>'
    )


def _generation(generation: int, at: int, left_out: int) -> str:
    """Name of a generation, and how many of it are not shown."""
    more = f'<tspan x="0" dy="16" fill="#6b727c">and {left_out} more</tspan>' if left_out else ""
    return f'<text x="0" y="{_DOWN * at + 34}" font-size="12">generation {generation}{more}</text>'


def _link(parent: tuple[float, float], child: tuple[float, float], is_line: bool) -> str:
    """A curve from below the parent to above the child."""
    x, y, to_x, to_y = parent[0] + _SIZE / 2, parent[1] + _SIZE + 30, child[0] + _SIZE / 2, child[1] + 4
    middle = (y + to_y) / 2
    look = f'stroke="{_LINE}" stroke-width="2"' if is_line else f'stroke="{_PLAIN}" stroke-width="1"'
    return f'<path d="M{x:g} {y:g}C{x:g} {middle:g} {to_x:g} {middle:g} {to_x:g} {to_y:g}" fill="none" {look}/>'


def _individual(row: Row, place: tuple[float, float], is_line: bool, is_best: bool) -> str:
    """A body, its fitness and number."""
    body = Body(row["body"], row.get("connections"))
    x, y = place
    scale = _SIZE / max(body.shape)
    parent = "random" if row.get("parent") is None else f"from {row['parent']}"
    hint = f"number {row['index']}, {parent}, fitness {row['fitness']:.3f}\n{body.text}"
    weight = ' font-weight="700"' if is_best else ""
    ink = _LINE if is_line else "#191c21"
    number = f'<tspan x="{_SIZE / 2:g}" dy="13" fill="#6b727c" font-weight="400">no. {row["index"]}</tspan>'
    text = f'<text x="{_SIZE / 2:g}" y="{_SIZE + 13}" text-anchor="middle" font-size="12" fill="{ink}"{weight}>'
    return (
        f'<g transform="translate({x:g} {y + 6:g})"><title>{escape(hint)}</title>'
        f'<rect x="-3" y="-3" width="{_SIZE + 6}" height="{_SIZE + 32}" fill="#fff"/>'
        f'<g transform="scale({scale:.4g})">{body_shapes(body)}</g>{text}{row["fitness"]:z.2f}{number}</text></g>'
    )
