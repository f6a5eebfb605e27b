"""Map files: what goes in comes out, and nothing else is taken for a map."""

import json
from pathlib import Path
import zipfile

import numpy as np
import pytest

from dlsc_qbs_ros.errors import MapError
from dlsc_qbs_ros.io.map_file import FORMAT, is_there, read_map, VERSION, write_map

CONFIG = {'view.width': 43, 'ratslam.map_frame': 'map', 'recorder.topics': []}
ARRAYS = {'poses': np.arange(6.0).reshape(2, 3), 'views': np.zeros((2, 4, 5), np.uint8),
          'links': np.zeros((0, 2), np.int64), 'is_closure': np.array([True, False])}


@pytest.fixture
def path(tmp_path):
    """Give the path of a map file."""
    write_map(tmp_path / 'hall.map', CONFIG, ARRAYS)
    return tmp_path / 'hall.map'


def forge(path, members, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, 'w', compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def header(**changes):
    return json.dumps({'format': FORMAT, 'version': VERSION, 'config': {}, **changes})


def test_what_was_written_is_read(path):
    config, arrays = read_map(path)
    assert config == CONFIG
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array)


def test_numpy_opens_the_file_and_needs_no_pickle(path):
    with np.load(path, allow_pickle=False) as archive:
        np.testing.assert_array_equal(archive['poses'], ARRAYS['poses'])


def test_the_same_map_gives_the_same_bytes(path, tmp_path):
    write_map(tmp_path / 'again.map', CONFIG, dict(reversed(ARRAYS.items())))
    assert (tmp_path / 'again.map').read_bytes() == path.read_bytes()


def test_a_list_of_arrays_is_an_array(tmp_path):
    write_map(tmp_path / 'a.map', {}, {'views': [np.zeros((4, 5), np.uint8)] * 2})
    assert read_map(tmp_path / 'a.map')[1]['views'].shape == (2, 4, 5)


# Written whole or not at all

def test_a_write_that_fails_leaves_the_file_that_was_there(path):
    before = path.read_bytes()
    path.with_name('hall.map.part').mkdir()
    with pytest.raises(MapError, match=r'hall\.map: cannot be written: Is a directory'):
        write_map(path, CONFIG, {})
    assert path.read_bytes() == before


def test_a_write_that_was_cut_is_no_hindrance_to_the_next(path):
    path.with_name('hall.map.part').write_bytes(b'half a m')
    write_map(path, CONFIG, {})
    assert read_map(path)[1] == {}
    assert [*path.parent.iterdir()] == [path]


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(MapError, match='maps/hall.map: cannot be written: No such file'):
        write_map(tmp_path / 'maps' / 'hall.map', CONFIG, ARRAYS)


# Refused

@pytest.mark.parametrize('name, said', [
    ('~nobody-of-that-name/hall.map', 'home directory'), ('n' * 300, 'File name too long')])
def test_a_path_that_can_name_nothing_is_refused_in_words(tmp_path, name, said):
    path = name if name.startswith('~') else tmp_path / name
    for use in (is_there, read_map, lambda path: write_map(path, CONFIG, ARRAYS)):
        with pytest.raises(MapError, match=said):
            use(path)


def test_a_folder_is_not_written_over(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MapError, match='cannot be written'):
        write_map('.', CONFIG, ARRAYS)
    assert not [*tmp_path.iterdir()]


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(MapError, match='hall.map: no such file'):
        read_map(tmp_path / 'hall.map')


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(MapError, match='no such file'):
        read_map(tmp_path)


def test_wherever_it_is_cut_a_file_is_refused(path):
    content = path.read_bytes()
    for n in range(0, len(content), 7):
        path.write_bytes(content[:n])
        with pytest.raises(MapError, match='hall.map: cut, damaged or no map'):
            read_map(path)


def test_whatever_byte_is_damaged_nothing_false_is_read(path):
    """A flag or a date of the archive may change what nobody reads."""
    content, n_read = path.read_bytes(), 0
    for k in range(len(content)):
        path.write_bytes(content[:k] + bytes([content[k] ^ 0x21]) + content[k + 1:])
        try:
            config, arrays = read_map(path)
        except MapError as error:
            assert 'hall.map: ' in str(error)
            continue
        n_read += 1
        assert config == CONFIG
        for name in arrays.keys() & ARRAYS.keys():
            np.testing.assert_array_equal(arrays[name], ARRAYS[name])
    assert n_read < 0.3 * len(content)


@pytest.mark.parametrize('content', [b'', b'\0' * 1000, b'%PDF-1.7 \n', b'PK\3\4' + b'\7' * 99])
def test_what_is_no_archive_is_refused(tmp_path, content):
    (tmp_path / 'a.map').write_bytes(content)
    with pytest.raises(MapError, match='a.map: cut, damaged or no map'):
        read_map(tmp_path / 'a.map')


@pytest.mark.parametrize('members, said', [
    ({'mimetype': 'text'}, 'another kind of archive'),
    ({'map.json': header(format='octomap')}, "does not say 'dlsc_qbs_ros map'"),
    ({'map.json': '[]'}, "does not say 'dlsc_qbs_ros map'"),
    ({'map.json': '{'}, 'cut, damaged or no map'),
    ({'map.json': '[' * 100_000}, 'cut, damaged or no map'),
    ({'map.json': header(version=VERSION + 1)}, 'a newer package made it'),
    ({'map.json': header(version=VERSION - 1)}, f'version {VERSION - 1}: expected {VERSION}$'),
    ({'map.json': header(version='1')}, 'lacks a version'),
    ({'map.json': header(config=None)}, 'lacks a version or a configuration'),
    ({'map.json': header(), 'run.sh': ''}, "foreign member 'run.sh'"),
    ({'map.json': header(), 'poses.npy': 'x'}, 'cut, damaged or no map'),
])
def test_what_is_another_archive_or_version_is_refused_in_words(tmp_path, members, said):
    forge(tmp_path / 'a.map', members)
    with pytest.raises(MapError, match=f'a.map: .*{said}'):
        read_map(tmp_path / 'a.map')


def npy(shape, content=b'', dtype='<f8'):
    head = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + '\n'
    return b'\x93NUMPY\1\0' + len(head).to_bytes(2, 'little') + head.encode() + content


@pytest.mark.parametrize('content', [
    npy((1 << 40,)), npy((-1,)), npy((2,), b'8 bytes.'), npy((1,), b'8 bytes.and more'),
    npy((1,), b'\x80\4N.    ', '|O')])
def test_an_array_that_is_not_what_it_says_is_refused(tmp_path, content):
    forge(tmp_path / 'a.map', {'map.json': header(), 'poses.npy': content})
    with pytest.raises(MapError, match='a.map: '):
        read_map(tmp_path / 'a.map')


def test_what_would_unfold_to_more_than_it_takes_is_refused(tmp_path):
    forge(tmp_path / 'a.map', {'map.json': header(), 'poses.npy': bytes(10**6)},
          zipfile.ZIP_DEFLATED)
    with pytest.raises(MapError, match='is compressed'):
        read_map(tmp_path / 'a.map')


def test_a_home_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    write_map(Path('~/hall.map'), CONFIG, ARRAYS)
    assert read_map('~/hall.map')[0] == CONFIG
