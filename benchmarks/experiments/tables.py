"""Tables in Markdown, and numbers as they stand in them."""

from collections.abc import Sequence


def table(lines: Sequence[Sequence[str]]) -> str:
    """Returns lines of cells, the head first, as a Markdown table whose columns stand one under another."""
    widths = [max(3, *map(len, column)) for column in zip(*lines, strict=True)]
    ruled = [lines[0], ["-" * width for width in widths], *lines[1:]]
    return "\n".join(f"| {' | '.join(map(str.ljust, line, widths))} |" for line in ruled)


def with_interval(value: float, interval: Sequence[float] | None, form: str) -> str:
    """Returns a number with its interval, where there is one."""
    if interval is None:
        return format(value, form)
    return f"{value:{form}} [{interval[0]:{form}}, {interval[1]:{form}}]"


def joined(values: Sequence[float]) -> str:
    """Returns the numbers one after another."""
    return " ".join(f"{value:.2f}" for value in values)
