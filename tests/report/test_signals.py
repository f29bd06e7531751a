"""Signals, complete and in part."""

import pytest

from evogymcm.report.signals import signal_parts


def titles(parts):
    return [getattr(part, "title", part.kind) for part in parts]


def test_everything_is_shown(signals):
    parts = signal_parts(signals)
    assert titles(parts) == [
        "Actuation and stiffness of one voxel", "All voxels over time", "On the body", "Spectra",
        "Stiffness around impacts", "Actuators",
    ]  # fmt: skip
    series, maps, body, spectra, impacts, table = parts
    assert {trace.name for trace in series.figure.data} == {"stiffness", "actuation (target length)", "on the ground"}
    assert [trace.z.shape for trace in maps.figure.data] == [(2, 60), (3, 60)]
    assert len(body.pictures) == 3
    assert len(spectra.figure.data) == 2
    assert "7 impacts" in impacts.caption
    assert "+0.125" in impacts.caption
    assert list(table.head) == ["voxel", "frequency of actuation", "of stiffness", "phase lag (rad)",
                                "lag (env-steps)", "correlation"]  # fmt: skip
    assert table.rows[0] == ["row 0, column 0", "10.6", "10.6", "+1.00", "+5", "0.90"]
    assert len(table.rows) == 2


@pytest.mark.parametrize("key", ["voxels", "spectra", "contact", "step_seconds", "task"])
def test_what_is_missing_is_left_out(signals, key):
    del signals[key]
    lost = {"voxels": 4, "spectra": 1, "contact": 1}.get(key, 0)
    assert len(signal_parts(signals)) == 6 - lost


@pytest.mark.parametrize("key", ["row", "actuation", "contact", "phase_lag", "correlation", "stiffness", "is_actuator"])
def test_voxels_may_lack_anything(signals, key):
    for voxel in signals["voxels"]:
        del voxel[key]
    parts = signal_parts(signals)
    assert ("Actuation and stiffness of one voxel" in titles(parts)) == (key != "stiffness")


def test_no_impacts_and_nothing_at_all(signals):
    signals["contact"] |= {"n_impacts": 0, "stiffness": [None, None, None]}
    assert "No voxel came down" in signal_parts(signals)[-2].text
    assert "no signals" in signal_parts({})[0].text
