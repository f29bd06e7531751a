"""Writes the table of what environments take by name into docs/concepts.md, from the one list of options.

    python docs/option_table.py            # prints the table
    python docs/option_table.py --write    # puts it into docs/concepts.md

The rows are those of `evogymcm.envs.options`, with the defaults and texts that they have there.
"""

import argparse
import inspect
import re
from pathlib import Path

from evogymcm.envs import (
    BodiesParallelEnv,
    EngineOptions,
    GymnasiumEnv,
    GymnasiumVectorEnv,
    PopulationEnv,
    SoftRobotEnv,
    TaskEngine,
    WorldOptions,
)
from evogymcm.envs.options import DEFAULTS

PAGE = Path(__file__).resolve().parent / "concepts.md"
BEGIN, END = "<!-- options: written by docs/option_table.py -->\n", "<!-- end of options -->\n"
CONSTRUCTORS = {
    "gymnasium.make": GymnasiumEnv,
    "gymnasium.make_vec": GymnasiumVectorEnv,
    "SoftRobotEnv": SoftRobotEnv,
    "population_env": PopulationEnv,
    "parallel_env": BodiesParallelEnv,
    "TaskEngine": TaskEngine,
}


def meanings() -> dict[str, str]:
    """Returns what each option means, as its docstring says."""
    texts = {}
    for options in (WorldOptions, EngineOptions):
        listed = inspect.getdoc(options) or ""
        for name, text in re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", listed, re.MULTILINE):
            texts[name] = re.sub(r"\s+", " ", text)
    return texts


def table() -> str:
    """Returns the options in Markdown, and what each constructor takes besides."""
    lines = ["| option | default | what |", "| --- | --- | --- |"]
    texts = meanings()
    lines += [f"| `{name}` | `{default!r}` | {texts[name]} |" for name, default in DEFAULTS.items()]
    lines += ["", "| | first | also by name |", "| --- | --- | --- |"]
    for name, constructor in CONSTRUCTORS.items():
        parameters = list(inspect.signature(constructor.__init__).parameters.values())[1:]
        own = [p for p in parameters if p.name not in DEFAULTS]
        first = ", ".join(f"`{p.name}`" for p in own if p.kind is not p.KEYWORD_ONLY)
        by_name = ", ".join(f"`{p.name}`" for p in own if p.kind is p.KEYWORD_ONLY)
        lines.append(f"| `{name}` | {first} | {by_name} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Prints the table, or writes it into its page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put it into docs/concepts.md")
    if not parser.parse_args().write:
        print(table(), end="")
        return
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    PAGE.write_text(before + BEGIN + "\n" + table() + "\n" + END + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
