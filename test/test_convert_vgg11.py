"""VGG-11 from torchvision's state dictionary to ONNX, with random weights of the true shapes."""

import sys

import numpy as np
import pytest

from dlsc_qbs_ros.baselines.onnx import OnnxEncoder
from dlsc_qbs_ros.baselines.vgg11 import COLUMNS, ROWS
from dlsc_qbs_ros.cli.convert_vgg11 import main

PLAN = (64, 'M', 128, 'M', 256, 256, 'M', 512, 512, 'M', 512, 512, 'M')


@pytest.fixture
def torch():
    """Return torch; without it and onnx, there is nothing to convert with."""
    pytest.importorskip('onnx', reason='the extra [train] is not installed')
    return pytest.importorskip('torch', reason='the extra [train] is not installed')


def vgg11(torch, batch_norm):
    """Return the convolutional layers as torchvision orders them, with weights at random."""
    nn = torch.nn
    torch.manual_seed(0)
    layers, channels = [], 3
    for step in PLAN:
        if step == 'M':
            layers.append(nn.MaxPool2d(2, 2))
            continue
        layers.append(nn.Conv2d(channels, step, 3, padding=1))
        nn.init.kaiming_normal_(layers[-1].weight)
        nn.init.normal_(layers[-1].bias, std=0.1)
        if batch_norm:
            layers.append(nn.BatchNorm2d(step))
            for values in (layers[-1].weight, layers[-1].running_var):
                nn.init.uniform_(values, 0.5, 2.0)
            for values in (layers[-1].bias, layers[-1].running_mean):
                nn.init.normal_(values, std=0.1)
        layers.append(nn.ReLU())
        channels = step
    return nn.Sequential(*layers).eval()


def state_of(torch, network):
    """Return the state dictionary with the keys of torchvision's; its classifier is cut short."""
    state = {f'features.{name}': values for name, values in network.state_dict().items()}
    return {**state, 'classifier.0.weight': torch.zeros(2, 2), 'classifier.0.bias': torch.zeros(2)}


@pytest.mark.parametrize('batch_norm', [False, True], ids=['vgg11', 'vgg11_bn'])
def test_opencv_gives_the_mean_of_each_quarter_of_what_torch_gives(
        torch, batch_norm, tmp_path, capsys):
    network = vgg11(torch, batch_norm)
    state = state_of(torch, network)
    first, last = ('features.0.weight', f'features.{25 if batch_norm else 18}.bias')
    assert state[first].shape == (64, 3, 3, 3)
    assert state[last].shape == (512,)
    torch.save(state, tmp_path / 'vgg11.pth')
    out = tmp_path / 'made' / 'vgg11.onnx'
    assert main([str(tmp_path / 'vgg11.pth'), '--out', str(out)]) == 0
    assert f'{out}: the convolutional layers of' in capsys.readouterr().out

    grey = np.random.default_rng(0).integers(0, 256, (ROWS, COLUMNS), dtype=np.uint8)
    mean, deviation = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225])
    image = (torch.from_numpy(grey / 255).float().expand(1, 3, -1, -1)
             - torch.tensor(mean)[:, None, None]) / torch.tensor(deviation)[:, None, None]
    with torch.no_grad():
        maps = network(image)[0].numpy()
    assert maps.shape == (512, 6, 8)
    quarters = maps.reshape(512, 2, 3, 2, 4).mean(axis=(2, 4))
    described = OnnxEncoder(out).describe(grey)
    np.testing.assert_allclose(described, quarters.ravel(), atol=1e-4 * quarters.max())


def refusal(capsys, path, out):
    assert main([str(path), '--out', str(out)]) == 1
    message = capsys.readouterr().err
    assert message.startswith('convert_vgg11: ')
    assert message.count('\n') == 1
    assert not out.is_file()
    return message


class TestRefusals:
    """One line, exit code 1, no file."""

    def test_a_missing_file(self, torch, tmp_path, capsys):
        assert 'none.pth: cannot be read: No such file' in refusal(
            capsys, tmp_path / 'none.pth', tmp_path / 'x.onnx')

    @pytest.mark.parametrize('content', [b'', b'not weights', b'PK\3\4' + bytes(100)])
    def test_a_file_of_something_else(self, torch, tmp_path, capsys, content):
        (tmp_path / 'x.pth').write_bytes(content)
        assert 'x.pth: not a file of weights that PyTorch reads safely' in refusal(
            capsys, tmp_path / 'x.pth', tmp_path / 'x.onnx')

    def test_a_whole_pickled_object_is_not_run(self, torch, tmp_path, capsys):
        torch.save(torch.nn.ReLU(), tmp_path / 'x.pth')
        assert 'not a file of weights that PyTorch reads safely' in refusal(
            capsys, tmp_path / 'x.pth', tmp_path / 'x.onnx')

    def test_a_tensor_in_place_of_a_dictionary(self, torch, tmp_path, capsys):
        torch.save(torch.zeros(3), tmp_path / 'x.pth')
        assert 'expected a state dictionary, found Tensor' in refusal(
            capsys, tmp_path / 'x.pth', tmp_path / 'x.onnx')

    def test_the_weights_of_another_network(self, torch, tmp_path, capsys):
        torch.save({'features.0.weight': torch.zeros(64, 3, 11, 11)}, tmp_path / 'x.pth')
        message = refusal(capsys, tmp_path / 'x.pth', tmp_path / 'x.onnx')
        assert 'not the weights of VGG-11: expected convolutions [(64, 3, 3, 3), ' in message
        assert 'found [(64, 3, 11, 11)]' in message

    def test_weights_without_their_biases(self, torch, tmp_path, capsys):
        state = state_of(torch, vgg11(torch, False))
        del state['features.8.bias']
        torch.save(state, tmp_path / 'x.pth')
        assert "'features.8.bias' is missing" in refusal(
            capsys, tmp_path / 'x.pth', tmp_path / 'x.onnx')

    @pytest.mark.parametrize('library', ['torch', 'onnx'])
    def test_no_library_to_convert_with(self, torch, tmp_path, capsys, monkeypatch, library):
        torch.save(state_of(torch, vgg11(torch, False)), tmp_path / 'x.pth')
        monkeypatch.setitem(sys.modules, library, None)
        assert f"'{library}' is missing: install the extra [train]" in refusal(
            capsys, tmp_path / 'x.pth', tmp_path / 'x.onnx')

    def test_a_folder_in_the_place_of_the_file_to_write(self, torch, tmp_path, capsys):
        torch.save(state_of(torch, vgg11(torch, False)), tmp_path / 'x.pth')
        assert f'{tmp_path}: cannot be written: Is a directory' in refusal(
            capsys, tmp_path / 'x.pth', tmp_path)
