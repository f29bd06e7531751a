"""The subcommands of `python -m evogymcm`, a module each, with `DESCRIPTION`, `Options` and `run`."""
