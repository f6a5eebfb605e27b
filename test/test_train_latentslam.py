"""The encoder of LatentSLAM: an autoencoder that learns, and an encoder that OpenCV runs."""

import sys

import numpy as np
import pytest

from dlsc_qbs_ros.baselines import latentslam
from dlsc_qbs_ros.baselines.latentslam import N_LATENT, Vae
from dlsc_qbs_ros.baselines.onnx import OnnxEncoder
from dlsc_qbs_ros.cli import simulate, train_latentslam
from dlsc_qbs_ros.core.types import Frame, GroundTruthSample, IDENTITY
from dlsc_qbs_ros.errors import ConfigError, RecordingError

WIDTH, HEIGHT = 32, 16


@pytest.fixture
def torch():
    """Return torch; without it and onnx, there is nothing to train with."""
    pytest.importorskip('onnx', reason='the extra [train] is not installed')
    return pytest.importorskip('torch', reason='the extra [train] is not installed')


def ramps(n, seed=0):
    """Return images that a few numbers describe: ramps of any direction and brightness."""
    rng = np.random.default_rng(seed)
    down, right = np.linspace(-1, 1, HEIGHT)[:, None], np.linspace(-1, 1, WIDTH)
    made = [128 + 60 * (a * down + b * right) + 30 * c for a, b, c in rng.uniform(-1, 1, (n, 3))]
    return np.clip(made, 0, 255).astype(np.uint8)


class TestVae:
    """The network and its loss."""

    def test_it_has_eleven_layers(self, torch):
        vae = Vae(WIDTH, HEIGHT, seed=0)
        layers = [layer for part in (vae._encoder, vae._decoder) for layer in part
                  if list(layer.parameters())]
        assert len(layers) == 11

    def test_what_is_decoded_has_the_size_of_the_image(self, torch):
        vae = Vae(WIDTH, HEIGHT, seed=0)
        assert vae._decoder(torch.zeros(3, N_LATENT)).shape == (3, 1, HEIGHT, WIDTH)

    def test_the_loss_goes_down(self, torch):
        losses = [epoch.loss for epoch in Vae(WIDTH, HEIGHT, seed=0).train(ramps(512), 20)]
        assert losses[-1] < 0.4 * losses[0]

    def test_the_loss_is_the_sum_of_its_two_terms(self, torch):
        for epoch in Vae(WIDTH, HEIGHT, seed=0).train(ramps(70), 2):
            assert epoch.loss == pytest.approx(epoch.reconstruction + epoch.divergence)
            assert epoch.divergence >= 0

    def test_the_terms_are_those_of_normal_distributions(self, torch, monkeypatch):
        """
        Against torch's own densities, of a code without deviation.

        A reconstruction that is off by d everywhere costs n d^2 / (2 sigma^2).
        """
        vae = Vae(WIDTH, HEIGHT, seed=0)
        mean, log_variance = torch.randn(4, N_LATENT), torch.randn(4, N_LATENT)
        vae._encoder = lambda images: torch.cat([mean, log_variance], dim=1)
        vae._decoder = lambda codes: torch.full((4, 1, HEIGHT, WIDTH), 0.5)
        reconstruction, divergence = vae._errors(torch.full((4, 1, HEIGHT, WIDTH), 0.3))
        normal, kl = torch.distributions.Normal, torch.distributions.kl_divergence
        expected = kl(normal(mean, torch.exp(log_variance / 2)), normal(0.0, 1.0)).sum()
        assert divergence.item() == pytest.approx(expected.item(), rel=1e-5)
        assert reconstruction.item() == pytest.approx(
            4 * WIDTH * HEIGHT * 0.2 ** 2 / (2 * latentslam.PIXEL_SIGMA ** 2), rel=1e-5)

    def test_the_same_seed_gives_the_same_network(self, torch):
        def codes(seed):
            vae = Vae(WIDTH, HEIGHT, seed)
            list(vae.train(ramps(100), 2))
            return vae.encode(ramps(5))
        first, second, other = codes(0), codes(0), codes(1)
        np.testing.assert_array_equal(first, second)
        assert np.abs(first - other).max() > 0.01

    def test_opencv_gives_the_mean_that_torch_gives(self, torch, tmp_path):
        vae = Vae(WIDTH, HEIGHT, seed=0)
        list(vae.train(ramps(64), 3))
        vae.save(tmp_path / 'x.onnx')
        encoder = OnnxEncoder(tmp_path / 'x.onnx')
        images = ramps(5, seed=1)
        means = vae.encode(images)
        assert means.shape == (5, N_LATENT)
        assert means.std() > 0.01
        np.testing.assert_allclose(
            [encoder.describe(image) for image in images], means, atol=1e-5)

    @pytest.mark.parametrize('size', [(40, 32), (32, 40), (0, 16), (8192, 16)])
    def test_a_size_that_cannot_be_halved_four_times_or_is_no_view_is_refused(self, torch, size):
        with pytest.raises(ConfigError, match='multiples of 16|expected a value in'):
            Vae(*size, seed=0)


def frames(n):
    return [Frame(k, image) for k, image in enumerate(ramps(n))]


@pytest.fixture
def flights(monkeypatch):
    """Put lists of events in the place of recordings, by path."""
    recorded = {}
    monkeypatch.setattr(train_latentslam, 'read_flight',
                        lambda path, *topics: iter(recorded[str(path)]))
    return recorded


class TestTool:
    """The command line."""

    def test_it_shows_the_loss_of_each_epoch_and_writes_the_encoder(
            self, torch, flights, tmp_path, capsys):
        flights['one'], flights['two'] = frames(40), frames(30)
        out = tmp_path / 'made' / 'latent.onnx'
        assert train_latentslam.main(
            ['one', 'two', '--epochs', '2', '--size', f'{WIDTH}x{HEIGHT}', '--out', str(out)]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert [line.partition(':')[0] for line in lines] == ['epoch 1/2', 'epoch 2/2', str(out)]
        assert 'trained on 70 frames of one, two' in lines[-1]
        assert OnnxEncoder(out).describe(ramps(1)[0]).shape == (N_LATENT,)

    def test_frames_are_taken_evenly_over_all_flights(self, torch, flights, tmp_path, monkeypatch):
        images = np.broadcast_to(
            np.arange(100, dtype=np.uint8)[:, None, None], (100, HEIGHT, WIDTH))
        events = [Frame(k, image) for k, image in enumerate(images)]
        flights['one'] = [GroundTruthSample(0, IDENTITY), *events[:60]]
        flights['two'] = events[60:]
        seen = []
        monkeypatch.setattr(Vae, 'train', lambda self, views, epochs: seen.append(views) or [])
        train_latentslam.main(['one', 'two', '--frames', '12', '--size', f'{WIDTH}x{HEIGHT}',
                               '--out', str(tmp_path / 'x.onnx')])
        assert seen[0][:, 0, 0].tolist() == [0, 9, 18, 27, 36, 45, 54, 63, 72, 81, 90, 99]

    def test_a_simulated_flight_is_learned(self, torch, tmp_path, capsys):
        pytest.importorskip('rclpy', reason='recordings are written and read by ROS')
        flight = str(tmp_path / 'flight')
        assert simulate.main(['--flight', '1', '--seconds', '3', '--encoding', 'mono8',
                              '--out', flight]) == 0
        capsys.readouterr()
        assert train_latentslam.main([flight, '--epochs', '40', '--size', '32x16', '--frames',
                                      '20', '--out', str(tmp_path / 'x.onnx')]) == 0
        losses = [float(line.split()[3]) for line in capsys.readouterr().out.splitlines()[:-1]]
        assert len(losses) == 40
        assert losses[-1] < 0.5 * losses[0]

    @pytest.mark.parametrize('arguments, message', [
        (['--frames', '0'], '--frames 0: expected at least 1'),
        (['--epochs', '-1'], '--epochs -1: expected at least 1'),
        (['--size', '64'], "--size '64': expected WIDTHxHEIGHT in pixels"),
        (['--size', '64x40'], 'size 64x40: expected multiples of 16'),
    ])
    def test_what_does_not_fit_is_refused_in_one_line(
            self, flights, tmp_path, capsys, arguments, message):
        assert train_latentslam.main(
            ['one', *arguments, '--out', str(tmp_path / 'x.onnx')]) == 1
        assert capsys.readouterr().err.startswith(f'train_latentslam: {message}')
        assert not list(tmp_path.iterdir())

    def test_a_flight_without_frames_is_refused(self, torch, flights, tmp_path, capsys):
        flights['one'] = [GroundTruthSample(0, IDENTITY)]
        assert train_latentslam.main(['one', '--out', str(tmp_path / 'x.onnx')]) == 1
        assert 'one: expected frames, found none' in capsys.readouterr().err

    def test_a_flight_that_cannot_be_read_is_refused(
            self, torch, tmp_path, capsys, monkeypatch):
        def refuse(path, *topics):
            raise RecordingError(f'{path}: not an MCAP file')
        monkeypatch.setattr(train_latentslam, 'read_flight', refuse)
        assert train_latentslam.main(['one', '--out', str(tmp_path / 'x.onnx')]) == 1
        assert 'train_latentslam: one: not an MCAP file' in capsys.readouterr().err

    def test_without_pytorch_the_extra_is_named(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setitem(sys.modules, 'torch', None)
        assert train_latentslam.main(['one', '--out', str(tmp_path / 'x.onnx')]) == 1
        assert "'torch' is missing: install the extra [train]" in capsys.readouterr().err
