"""The simulator: arrays in, arrays out. It knows no task and no torch."""
