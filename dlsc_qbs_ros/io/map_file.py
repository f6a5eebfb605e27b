"""
Map files: the arrays of a map and the configuration they were made with, in one zip archive.

An archive holds `map.json`, an object with `format` (`FORMAT`), `version` and `config`, and one
member NAME.npy per array, in numpy's format. Members are stored as they are, so `numpy.load`
opens the archive as well. The same map gives the same bytes. Zip guards every member by a CRC,
and its directory comes last, so a file that was cut is none.
"""

from __future__ import annotations

from io import BytesIO
import json
from pathlib import Path
from typing import Any, Mapping
import zipfile

import numpy as np

from .disk import replacement, sync
from ..errors import MapError

FORMAT = 'dlsc_qbs_ros map'
VERSION = 4
HEADER = 'map.json'
SUFFIX = '.npy'


def write_map(path: Path, config: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """
    Write a map file; whatever happens meanwhile, the path names the old one or the new one.

    Raises
    ------
    MapError
        When it cannot be written.

    """
    path = _expanded(path)
    try:
        with replacement(path, synced=True) as stream:
            _write_archive(stream, config, arrays)
        sync(path.parent)
    except OSError as error:
        raise MapError(f'{path}: cannot be written: {error.strerror}') from error


def read_map(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """
    Read a map file; nothing in it is believed before it is checked, nothing is executed.

    Returns
    -------
    tuple
        The configuration, `section.name`: value, and the arrays by name.

    Raises
    ------
    MapError
        When the file is missing, cut, damaged, foreign or of a newer version.

    """
    path = _expanded(path)
    try:
        if not path.is_file():
            raise MapError('no such file')
        with zipfile.ZipFile(path) as archive:
            config = _read_header(archive)
            return config, {
                info.filename[:-len(SUFFIX)]: _read_array(archive, info)
                for info in archive.infolist() if info.filename != HEADER}
    except MapError as error:
        raise MapError(f'{path}: {error}') from error
    except OSError as error:
        raise MapError(f'{path}: cannot be read: {error.strerror}') from error
    except Exception as error:  # zipfile and numpy raise whatever a damaged byte leads them to
        raise MapError(f'{path}: cut, damaged or no map: {error}') from error


def is_there(path: Path) -> bool:
    """Return whether anything has that path; raise MapError where that is not to be seen."""
    path = _expanded(path)
    try:
        return path.exists()
    except OSError as error:
        raise MapError(f'{path}: cannot be read: {error.strerror}') from error


def _expanded(path: Path) -> Path:
    try:
        return Path(path).expanduser()
    except RuntimeError as error:  # the home of a user there is none of
        raise MapError(f'{path}: {error}') from error


def _write_archive(stream, config: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    header = {'format': FORMAT, 'version': VERSION, 'config': dict(config)}
    with zipfile.ZipFile(stream, 'w') as archive:
        # An entry without a date of its own has that of 1980, so that bytes depend on the map.
        archive.writestr(zipfile.ZipInfo(HEADER), json.dumps(header, indent=1, sort_keys=True))
        for name in sorted(arrays):
            with archive.open(zipfile.ZipInfo(name + SUFFIX), 'w', force_zip64=True) as member:
                np.lib.format.write_array(
                    member, np.ascontiguousarray(arrays[name]), (1, 0), allow_pickle=False)


def _read_header(archive: zipfile.ZipFile) -> dict[str, Any]:
    if HEADER not in archive.namelist():
        raise MapError('no map: it is another kind of archive')
    header = json.loads(_content(archive, archive.getinfo(HEADER)))
    if not isinstance(header, dict) or header.get('format') != FORMAT:
        raise MapError(f'no map: its header does not say {FORMAT!r}')
    version, config = header.get('version'), header.get('config')
    if type(version) is not int or not isinstance(config, dict):
        raise MapError('damaged: its header lacks a version or a configuration')
    if version != VERSION:
        raise MapError(f'version {version}: expected {VERSION}; a newer package made it'
                       if version > VERSION else f'version {version}: expected {VERSION}')
    return config


def _read_array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    if not info.filename.endswith(SUFFIX):
        raise MapError(f'foreign member {info.filename!r}')
    stream = BytesIO(_content(archive, info))
    array = np.load(stream, allow_pickle=False)
    if stream.read(1):
        raise MapError(f'{info.filename!r} is longer than its array')
    return array


def _content(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    """Return what a member holds; one that would unfold to more than it takes is refused."""
    if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
        raise MapError(f'member {info.filename!r} is compressed')
    return archive.read(info)
