"""The benchmark of the environments measures what its table says."""

from __future__ import annotations

from benchmarks import envs


def test_one_repetition_fills_every_row():
    measurement = envs.Measurement.prepare("HC0", [1, 2])
    measurement.repeat(0)
    assert [row.n_clients for row in measurement.rows] == [1, 1, 2, 2, 1, 1]
    assert all(len(row.rates) == 1 and row.rates[0] > 0 for row in measurement.rows)
    # Reading the state costs something, and the public package reads it link by link.
    assert measurement.peer.rates[0] < measurement.batched[0].rates[0] < measurement.raw[0].rates[0]
    table = measurement.table().splitlines()
    assert len(table) == 6
    assert table[0].split()[-2] == "100.0%"
    assert "of raw with" in measurement.verdict()
