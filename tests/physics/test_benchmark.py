"""The benchmark of the environments measures what its table says."""

from __future__ import annotations

from benchmarks import envs


def test_rows_are_filled_and_compared():
    measurement = envs.Measurement.prepare("HC0", [1, 2])
    for seed in range(3):
        measurement.repeat(seed)
    assert [row.n_clients for row in measurement.rows] == [1, 1, 2, 2, 1, 1]
    assert all(len(row.rates) == 3 and min(row.rates) > 0 for row in measurement.rows)
    # Reading the state costs something, and the public package reads it link by link.
    assert measurement.batched[0].times(measurement.raw[0]) < 1
    assert measurement.batched[0].times(measurement.peer) > 1
    table = measurement.table().splitlines()
    assert len(table) == 6
    assert table[0].split()[-2] == "100.0%"
    assert "of raw with" in measurement.verdict()
