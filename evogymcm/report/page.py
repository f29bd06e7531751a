"""The page: its sections, and how it is written."""

from collections.abc import Sequence
from itertools import count
from pathlib import Path

from evogymcm._extras import load_extra, load_plotly
from evogymcm.algos.analysis import interval_note
from evogymcm.algos.runs.record import Kind
from evogymcm.report import figures, tables
from evogymcm.report.designs import design_sections
from evogymcm.report.parts import Figure, Fold, Note, Part, Picture, Pictures, Section
from evogymcm.report.signals import signal_parts
from evogymcm.report.sources import Arm, Source, make_arms, read_sources
from evogymcm.report.work import work_section


def write_report(
    runs: Sequence[str | Path], out: str | Path, *, overwrite: bool = False, animations: bool = True
) -> Path:
    """Writes a report on run folders, in one step, and returns its path.

    Args:
        runs: folders of training runs, co-design runs, suites, or folders of such runs; compared side by side.
        out: the HTML file.
        overwrite: whether an existing file may be replaced.
        animations: whether to show the best designs in motion, where policies are saved and the extra `render` is
            installed.

    Raises:
        FileExistsError: The file exists, and `overwrite` is not set.
        ImportError: A package of the extra `report` is missing.
        ValueError: A run's folder is missing, holds no run, or has a file that cannot be read; or the file's name does
            not end in .html, or its folder does not exist.
    """
    out = Path(out)
    write_page(prepare([Path(run) for run in runs], out, overwrite=overwrite), out, animations=animations)
    return out


def prepare(runs: Sequence[Path], out: Path, *, overwrite: bool) -> list[Source]:
    """Returns what the report is on, read once all else is fine; for its errors see `write_report`."""
    if out.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"out: got {out.name!r}, the suffix must be .html")
    if not out.parent.is_dir():
        raise ValueError(f"out: the folder {out.parent} does not exist")
    if out.exists() and not overwrite:
        raise FileExistsError(f"{out} exists; set overwrite to replace it")
    _check_packages()
    return read_sources(runs)


def write_page(sources: Sequence[Source], out: Path, *, animations: bool) -> None:
    """Writes the report on what has been read, in one step."""
    from evogymcm._files import write_atomic

    page = _page(sources, animations=animations)
    write_atomic(out, lambda part: part.write_text(page, encoding="utf-8"))


def make_report(runs: Sequence[str | Path], *, animations: bool = True) -> str:
    """Returns the page of `write_report` as text.

    Raises:
        ImportError: A package of the extra `report` is missing.
        ValueError: A folder is missing, holds no run, or one of its files cannot be read.
    """
    _check_packages()
    return _page(read_sources([Path(run) for run in runs]), animations=animations)


def _check_packages() -> None:
    """Raises an ImportError, naming the extra, where one of its packages is missing."""
    load_plotly()
    load_extra("jinja2", "reports need jinja2, which cannot be imported", "report")


def _page(sources: Sequence[Source], *, animations: bool) -> str:
    arms = make_arms(sources)
    sections = [
        _origin(sources),
        *_training(arms),
        *_codesign(arms),
        work_section(arms),
        *design_sections(arms),
        *_signals(arms),
        *(_animations(arms) if animations else []),
    ]
    return _render(", ".join(source.name for source in sources), [section for section in sections if section.parts])


def _origin(sources: Sequence[Source]) -> Section:
    parts: list[Part] = [tables.source_table(sources)]
    missing = [
        f"{source.name}: {source.planned - len(source.runs)} of {source.planned} planned runs have not begun."
        for source in sources
        if source.planned and source.planned > len(source.runs)
    ]
    stopped = [run.name for source in sources for run in source.runs if not run.finished]
    if stopped:
        missing.append(f"Not run to the end: {', '.join(stopped)}.")
    return Section("What this is made from", [*parts, *map(Note, missing)])


def _counts(arms: Sequence[Arm], kind: Kind) -> list[int]:
    """Returns the number of seeds of each task and arm."""
    found = [len(arm.of(task, kind)) for task in tables.tasks_of(arms, kind) for arm in arms]
    return [count for count in found if count]


def _training(arms: Sequence[Arm]) -> list[Section]:
    """Scores and curves of trained policies."""
    counts = _counts(arms, "train")
    if not counts:
        return []
    caption = (
        "The score is the sum of an episode's rewards but the last, of the deterministic policy. Final: of the last"
        " policy. Best of training: the largest of all evaluations, which is never below the final score and profits"
        " from chance. In brackets the standard deviation over seeds (n - 1). "
    )
    if any(arm.paper for arm in arms):
        caption += "The paper's scores are of three seeds, each the best of about 100 evaluations. "
    parts: list[Part] = [tables.training_scores(arms, caption + interval_note(counts))]
    note = "Bands are the table's intervals, evaluation by evaluation; thin lines are single seeds."
    for task in tables.tasks_of(arms, "train"):
        extra = " Dotted: the paper's score." if any(task in arm.paper for arm in arms) else ""
        shown = note + extra if max(counts) > 1 else extra.strip()
        parts.append(Figure(task, figures.curves(task, arms, "train"), shown))
    return [Section("Training", parts)]


def _codesign(arms: Sequence[Arm]) -> list[Section]:
    """Best scores of co-design."""
    counts = _counts(arms, "codesign")
    if not counts:
        return []
    caption = (
        "The best score that a run had found when the task's shortest run ended; env-steps are those of all kinds,"
        " evaluations included. At the end: where each run itself ended, at other budgets. In brackets the standard"
        " deviation over seeds (n - 1). "
    )
    parts: list[Part] = [tables.codesign_scores(arms, caption + interval_note(counts))]
    note = "Mean over seeds with the table's interval, as far as all seeds have a score; thin lines are single seeds."
    for task in tables.tasks_of(arms, "codesign"):
        parts.append(Figure(task, figures.curves(task, arms, "codesign"), note if max(counts) > 1 else ""))
    return [Section("Co-design", parts)]


def _signals(arms: Sequence[Arm]) -> list[Section]:
    """Signals of all runs that have them."""
    runs = [(arm, run) for arm in arms for run in arm.runs if run.signals]
    folds: list[Part] = []
    for i, (arm, run) in enumerate(runs):
        assert run.signals is not None
        folds.append(Fold(arm.title(run), signal_parts(run.signals), is_open=i == 0))
    note = Note("One episode of the deterministic policy, voxel by voxel.")
    return [Section("Signals of policies that set stiffness", [note, *folds])] if folds else []


def _animations(arms: Sequence[Arm]) -> list[Section]:
    """The best designs in motion, or why there are none."""
    from evogymcm.report.animations import animate, choose_scenes

    scenes, notes = choose_scenes(arms)
    pictures = []
    for scene in scenes:
        try:
            uri, caption = animate(*scene)
        except ImportError as error:
            return [Section("Best designs in motion", [Note(f"Left out: {error}")])]
        except ValueError as error:
            notes.append(f"{scene[1].name}: {error}")
            continue
        pictures.append(Picture(f'<img src="{uri}" width="360" height="200" alt="animation">', caption))
    parts: list[Part] = [Pictures("", pictures)] if pictures else []
    if notes:
        parts.append(Note(" ".join(notes)))
    return [Section("Best designs in motion", parts)] if parts else []


def _render(title: str, sections: Sequence[Section]) -> str:
    """Returns the page."""
    from importlib.resources import files

    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    from evogymcm import __version__

    environment = Environment(
        loader=PackageLoader("evogymcm.report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    numbers = count(1)

    def plot(part: Figure) -> Markup:
        html = part.figure.to_html(
            full_html=False,
            include_plotlyjs=False,
            include_mathjax=False,
            div_id=f"figure-{next(numbers)}",
            default_height=f"{part.height}px",
            config={"responsive": True, "displaylogo": False},
        )
        return Markup(html)

    environment.globals["plot"] = plot
    environment.filters["markup"] = Markup
    style = files("evogymcm.report").joinpath("templates/report.css").read_text(encoding="utf-8")
    return environment.get_template("report.html").render(
        title=title, sections=sections, version=__version__, style=Markup(style), plotly=Markup(get_plotlyjs())
    )
