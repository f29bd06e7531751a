"""Experiments: each says which runs there are, what to tell of them and how to show it (`experiment.py`).

`program.py` runs any of them, spread over processes (`workers.py`), with settings from the command line (`options.py`).
"""
