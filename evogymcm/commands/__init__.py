"""The subcommands of `python -m evogymcm`, a module each, with `add_parser` and `run`."""
