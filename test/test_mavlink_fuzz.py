"""A short run of the fuzzer: no exception, nothing that is not finite or in order, none lost."""

import importlib
from pathlib import Path

import pytest

N_PACKETS = 2500
WAYS = [f'{mutate}, {"signed" if signed else "unsigned"}, {"datagrams" if datagrams else "stream"}'
        for mutate in ('damaged', 'forged') for signed in (False, True)
        for datagrams in (True, False)]


@pytest.mark.parametrize('way', range(8), ids=WAYS)
def test_mutated_packets_are_survived_and_good_ones_between_them_counted(
        way, monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(Path(__file__).parent.parent / 'benchmarks')
    fuzzer = importlib.import_module('fuzz_mavlink')
    mutate, signed, datagrams = fuzzer.WAYS[way]
    key_file = fuzzer.write_key(tmp_path / 'key') if signed else None
    result = fuzzer.fuzz(N_PACKETS, 0, mutate, key_file, datagrams)
    assert result.is_sound, result
    assert result.mutated >= N_PACKETS
    assert result.samples > 0.9 * result.good_odometry
