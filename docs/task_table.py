"""Writes the table of tasks in README.md and docs/tasks.md from the registry.

    python docs/task_table.py            # prints the table
    python docs/task_table.py --write    # puts it into both files

The rows are those of `evogymcm tasks`, what to do is each task's `about`.
"""

import argparse
from pathlib import Path

from evogymcm.commands.tasks import table as task_rows

FILES = (Path(__file__).resolve().parents[1] / "README.md", Path(__file__).resolve().parent / "tasks.md")
BEGIN, END = "<!-- tasks: written by docs/task_table.py -->\n", "<!-- end of tasks -->\n"


def table() -> str:
    """Returns the table in Markdown: the tasks of the EvoGymCM paper, then the others."""
    head = ["| id | what to do | episode | score ceiling |", "| --- | --- | --- | --- |"]
    rows = [f"| `{r.id}` | {r.about} | {r.time_limit} | {r.ceiling} |" for r in task_rows()]
    return "\n".join(head + rows) + "\n"


def main() -> None:
    """Prints the table, or writes it into its files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put it into README.md and docs/tasks.md")
    if not parser.parse_args().write:
        print(table(), end="")
        return
    for path in FILES:
        before, rest = path.read_text(encoding="utf-8").split(BEGIN)
        path.write_text(before + BEGIN + "\n" + table() + "\n" + END + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
