from __future__ import annotations

import json
from io import BytesIO

import numpy as np

from clt.exporters import EXPORT_FORMATS


def arrays_of(recording):
    (one,) = EXPORT_FORMATS["npz"].write(recording, "run7").files
    assert one.name == "run7.npz"
    return np.load(BytesIO(one.make()), allow_pickle=False)


def test_numpy_reads_a_result(synthetic):
    recording = synthetic(n=30)
    arrays = arrays_of(recording)
    track, found = recording.estimate["R2"], recording.innovations
    assert arrays["robots"].tolist() == ["A1", "A2", "R1", "R2", "R3"]
    assert arrays["static"].tolist() == [True, True, False, False, False]
    assert arrays["position"][1].tolist() == [6.0, 0.0]
    assert np.isnan(arrays["position"][2:]).all()
    assert arrays["R2.estimate.stamp_ns"].dtype == np.int64
    assert np.array_equal(arrays["R2.estimate.stamp_ns"], track.stamp)
    assert np.array_equal(arrays["R2.estimate.covariance"], track.covariance)
    assert arrays["R2.estimate.frame"] == "world"
    assert np.array_equal(arrays["R1.ground_truth.heading"], recording.truth["R1"].heading)
    assert np.array_equal(arrays["innovations.residual"], found.residual)
    assert np.array_equal(arrays["innovations.accepted"], found.accepted)
    assert json.loads(str(arrays["run"])) == {"filter": "eskf"}
    assert "ranges.range" not in arrays


def test_numpy_reads_measurements(measured):
    arrays = arrays_of(measured)
    assert np.array_equal(arrays["R1.odometry.omega"], measured.odometry["R1"].omega)
    ends = arrays["robots"][arrays["ranges.source"][:3]].tolist()
    assert set(ends) <= {"R1", "R2"}
    assert np.array_equal(arrays["ranges.range"], measured.ranges.range)
    assert "innovations.nis" not in arrays


def test_the_same_log_gives_the_same_bytes(measured):
    first, second = (EXPORT_FORMATS["npz"].write(measured, "a").files[0].make() for _ in range(2))
    assert first == second
