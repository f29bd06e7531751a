"""What a page is made of; `templates/report.html` shows each kind."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar


@dataclass(frozen=True)
class Note:
    """A paragraph."""

    kind: ClassVar[str] = "note"
    text: str


@dataclass(frozen=True)
class Table:
    """A table; `numeric` are the columns that are set to the right."""

    kind: ClassVar[str] = "table"
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    numeric: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Figure:
    """A plotly figure."""

    kind: ClassVar[str] = "figure"
    title: str
    figure: Any
    caption: str = ""
    height: int = 360  # pixels


@dataclass(frozen=True)
class Picture:
    """Markup of a picture (SVG or img), with what stands below it."""

    markup: str
    caption: str = ""


@dataclass(frozen=True)
class Pictures:
    """Pictures side by side, as many as fit."""

    kind: ClassVar[str] = "pictures"
    title: str
    pictures: Sequence[Picture]
    caption: str = ""
    is_wide: bool = False  # may be wider than the page, and then scrolls in its box


@dataclass(frozen=True)
class Fold:
    """Parts behind a title that opens and closes."""

    kind: ClassVar[str] = "fold"
    title: str
    parts: "Sequence[Part]"
    is_open: bool = False


Part = Note | Table | Figure | Pictures | Fold


@dataclass(frozen=True)
class Section:
    """A chapter of the page."""

    title: str
    parts: Sequence[Part] = field(default_factory=list)

    @property
    def anchor(self) -> str:
        """Where links lead."""
        return self.title.lower().replace(" ", "-")
