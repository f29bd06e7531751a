"""Writes the table of the package's baselines into docs/baselines.md, from their records.

python docs/baseline_table.py            # prints the table
python docs/baseline_table.py --write    # puts it into the page
"""

import argparse
from pathlib import Path

import evogymcm

PAGE = Path(__file__).resolve().parent / "baselines.md"
BEGIN, END = "<!-- baselines: written by docs/baseline_table.py -->\n", "<!-- end of baselines -->\n"


def table() -> str:
    """Returns the table in Markdown, and below it the commands that repeat the trainings."""
    head = ["| task | material | score | robust score | spread over starts | env-steps | hours | processor, commit |"]
    head.append("| --- | --- | --- | --- | --- | --- | --- | --- |")
    rows, commands = [], []
    for (task, material), record in evogymcm.baselines().items():
        origin = record["origin"]
        made = f"{origin['machine']['cpu']}, {origin['machine']['cores']} cores, `{(origin['commit'] or '')[:7]}`"
        cells = [f"`{task}`", material, *(f"{record[name]:.2f}" for name in ("score", "robust_score", "spread"))]
        cells += [f"{record['env_steps']:,}", f"{record['seconds'] / 3600:.1f}", made]
        rows.append(f"| {' | '.join(cells)} |")
        commands.append(record["command"])
    if not rows:
        return "This release has none.\n"
    return "\n".join([*head, *rows, "", "```sh", *commands, "```"]) + "\n"


def main() -> None:
    """Prints the table, or writes it into its page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put it into docs/baselines.md")
    if not parser.parse_args().write:
        print(table(), end="")
        return
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    PAGE.write_text(before + BEGIN + "\n" + table() + "\n" + END + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
