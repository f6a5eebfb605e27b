"""The benchmark of the encoder measures what it says it measures."""

import importlib
from itertools import islice
import json
from pathlib import Path

from algorithm_1 import algorithm_1
import cv2
from dlsc_qbs_ros.core.dictionary import DictionaryLearner
from dlsc_qbs_ros.core.preprocessing import make_view
from dlsc_qbs_ros.sim.simulation import simulate_flight
import numpy as np
import pytest
from vectors import vectors_of

BENCHMARKS = Path(__file__).parent.parent / 'benchmarks'
N_FRAMES = 20

# Sums over the eight 3x3 convolutions of VGG-11 on 224x224 pixels (Simonyan and Zisserman,
# configuration A): weights and biases, and operations, two per weight and output pixel.
VGG11_PARAMETERS = 9_220_480
VGG11_OPERATIONS = 14.97e9


@pytest.fixture(autouse=True)
def benchmarks_importable(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)


@pytest.fixture(scope='module')
def frames():
    return list(islice(simulate_flight(2, 0, 10.0).frames(), N_FRAMES))


def test_the_literal_case_is_algorithm_1(frames):
    cases = importlib.import_module('encoder_cases')
    config = cases.with_view(87, 65)
    step = cases.literal(config)
    inputs = vectors_of(
        np.array([make_view(frame.grey, config.view) for frame in frames]), True)
    codes = [step(frame, one) for frame, one in zip(frames, inputs)]
    options = config.encoder
    steps = list(algorithm_1(
        inputs, DictionaryLearner(87 * 65, options).atoms_.T, eta_c=options.eta_c,
        eta_d=options.eta_d, lambda_1=options.lambda_1, n_coding=options.n_coding,
        n_learning=options.n_learning))
    assert {step.learned for step in steps} == {True, False}
    np.testing.assert_allclose(codes, [step.code for step in steps], atol=1e-4)


def test_the_network_is_as_large_as_vgg11(frames):
    vgg11 = importlib.import_module('vgg11')
    n_parameters, depth = 0, 3
    for channels in filter(None, vgg11.LAYERS):
        n_parameters, depth = n_parameters + channels * (9 * depth + 1), channels
    assert n_parameters == VGG11_PARAMETERS
    assert 4 * n_parameters <= len(vgg11.model()) <= 4 * n_parameters + 4096
    network = vgg11.vgg11()
    network.setInput(vgg11.to_blob(frames[0].grey))
    features = network.forward()
    assert features.shape == (1, 512, 7, 7)
    assert 0.1 < features.std() < 10.0  # neither dead nor exploding


@pytest.mark.skipif(cv2.__version__.startswith('5.'), reason='getFLOPS fails in OpenCV 5')
def test_the_network_does_the_work_of_vgg11():
    network = importlib.import_module('vgg11').vgg11()
    assert network.getFLOPS((1, 3, 224, 224)) == pytest.approx(VGG11_OPERATIONS, rel=0.01)


def test_the_report_holds_the_floor_and_every_case_as_a_ratio_to_it(
        tmp_path, monkeypatch, capsys):
    bench = importlib.import_module('bench_encoder')
    for name, value in {'OUTPUT': tmp_path / 'encoder.json', 'SECONDS': 3.0, 'PASSES': 1,
                        'VIEW': (32, 24), 'VIEWS': ((32, 24),), 'ATOMS': (8,),
                        'STORED': (40,)}.items():
        monkeypatch.setattr(bench, name, value)
    bench.main()
    report = json.loads((tmp_path / 'encoder.json').read_text())
    cases = {case['name']: case for case in report['cases']}
    assert {'floor', 'dlsc_qbs', 'dlsc_qbs_learning', 'dlsc_qbs_not_learning', 'dlsc_qbs_epoch',
            'dlsc_qbs_43x32', 'dlsc_qbs_87x65', 'dlsc_qbs_small_board', 'dlsc_qbs_paper',
            'literal', 'orb', 'vgg11_forward'} <= set(cases)
    assert cases['floor']['ratio'] == 1.0
    for case in cases.values():
        assert case['ratio'] == pytest.approx(case['ms'] / report['floor_ms'])
        assert case['median_ratio'] <= case['worst_ratio']
    printed = capsys.readouterr().out
    assert all(name in printed for name in cases)
    assert all(line['name'] in printed for line in report['growth'])


def test_a_frame_counts_with_its_median_over_the_passes():
    bench = importlib.import_module('bench_encoder')
    passes = [[(1.0, 'learning'), (9.0, '')], [(7.0, 'learning'), (2.0, '')],
              [(2.0, 'learning'), (3.0, '')]]
    assert bench.over_passes(passes) == [(2.0, 'learning'), (3.0, '')]


def test_every_task_sees_every_frame_and_the_slow_ones_some(frames, monkeypatch):
    bench = importlib.import_module('bench_encoder')
    monkeypatch.setattr(bench, 'EVERY', {'vgg11_forward': 10})
    seen = {'quick': [], 'orb': [], 'vgg11_forward': []}
    samples = bench.interleave(
        {name: lambda frame, _, name=name: seen[name].append(frame) for name in seen},
        frames, bench.with_view(32, 24))
    assert seen['quick'] == seen['orb'] == frames
    assert seen['vgg11_forward'] == [frames[0], frames[10]]
    assert {name: len(taken) for name, taken in samples.items()} == {
        'quick': 20, 'orb': 20, 'vgg11_forward': 2}
