"""Charts of the page, as ECharts takes them."""

from collections.abc import Sequence
from typing import Any
from urllib.parse import quote

from evogymcm.studio.drawing import Drawing
from evogymcm.studio.page.theme import BLUE, ORANGE, thumbnail

_AXIS = {
    "nameLocation": "middle",
    "nameGap": 28,
    "nameTextStyle": {"color": "#66707c", "fontSize": 12},
    "axisLine": {"onZero": False, "lineStyle": {"color": "#c5ccd4"}},
    "axisTick": {"show": False},
    "axisLabel": {"color": "#66707c", "fontSize": 11, "hideOverlap": True},
    "splitLine": {"lineStyle": {"color": "#eef1f4"}},
}
_SIZE = 34  # pixels of a robot in the tree
_ROOM = ["12%", "12%"]  # around them


def curve_options(x: str, y: str) -> dict[str, Any]:
    """Returns a line chart of one curve, without points yet."""
    return {
        "animation": False,
        "grid": {"left": 52, "right": 18, "top": 12, "bottom": 42},
        "tooltip": {"trigger": "axis"},
        "xAxis": _AXIS | {"type": "value", "name": x, "max": "dataMax"},
        "yAxis": _AXIS | {"type": "value", "name": y, "nameGap": 36, "scale": True},
        "series": [
            {
                "type": "line",
                "name": y,
                "data": [],
                "symbolSize": 6,
                "itemStyle": {"color": BLUE},
                "lineStyle": {"width": 2.5},
            }
        ],
    }


def tree_options(nodes: Sequence[dict[str, Any]], edges: Sequence[tuple[int, int]]) -> dict[str, Any]:
    """Returns a family tree: robots over their number and score, with lines to their parents."""
    there = {node["index"] for node in nodes}
    return {
        "animation": False,
        "grid": {"left": 52, "right": 24, "top": 24, "bottom": 42},
        "tooltip": {"trigger": "item", "formatter": "{b}"},
        "xAxis": _AXIS | {"type": "value", "name": "design", "minInterval": 1, "boundaryGap": _ROOM},
        "yAxis": _AXIS | {"type": "value", "name": "score", "nameGap": 36, "scale": True, "boundaryGap": _ROOM},
        "series": [
            {
                "type": "graph",
                "coordinateSystem": "cartesian2d",
                "edgeSymbol": ["none", "none"],
                "lineStyle": {"color": "#b9c2cc", "width": 1.5, "curveness": 0.1},
                "tooltip": {"formatter": "design {b}"},
                "data": [_node(node) for node in nodes],
                "links": [
                    {"source": str(parent), "target": str(child)}
                    for parent, child in edges
                    if parent in there and child in there
                ],
            }
        ],
    }


def _node(node: dict[str, Any]) -> dict[str, Any]:
    picture = thumbnail(Drawing.of(node["body"], node["stiffness"]))
    return {
        "name": str(node["index"]),
        "value": [node["index"], node["score"]],
        "symbol": f"image://data:image/svg+xml,{quote(picture)}",
        "symbolSize": _SIZE + 14 * bool(node["is_best"]),
        "label": {"show": bool(node["is_best"]), "position": "top", "formatter": "best", "color": ORANGE},
    }
