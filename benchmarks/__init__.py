"""Speed, fidelity, and the experiments of `run_suite.py`."""
