"""
Write the complete lock of a requirements file, for every Python it is asked for.

    lock.py requirements.txt python3.10 python3.11 python3.12 python3.13 > requirements.lock
"""

from __future__ import annotations

import json
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory


def resolve(python: str, requirements: str) -> dict[str, str]:
    """Return name: version of everything pip would install for this interpreter."""
    with TemporaryDirectory() as folder:
        subprocess.run([python, '-m', 'venv', folder], check=True)
        report = Path(folder, 'report.json')
        subprocess.run(
            [f'{folder}/bin/pip', 'install', '-q', '--dry-run', '--ignore-installed',
             '--only-binary', ':all:', '--no-binary', 'empy',  # empy has no wheel
             '--report', report, '-r', requirements], check=True)
        packages = [item['metadata'] for item in json.loads(report.read_text())['install']]
    return {package['name']: package['version'] for package in packages}


def minor(python: str) -> str:
    """Return the interpreter's version as 3.x."""
    return subprocess.run(
        [python, '-c', 'import sys; print("%d.%d" % sys.version_info[:2])'],
        check=True, capture_output=True, text=True).stdout.strip()


def lines(resolved: dict[str, dict[str, str]]):
    """Yield one line per package and version, with a marker where not every Python has it."""
    for name in sorted({name for versions in resolved.values() for name in versions},
                       key=str.lower):
        pythons: dict[str, list[str]] = {}
        for python, versions in resolved.items():
            if name in versions:
                pythons.setdefault(versions[name], []).append(python)
        for version, users in pythons.items():
            marker = ' or '.join(f"python_version == '{python}'" for python in users)
            everywhere = len(users) == len(resolved)
            yield f'{name}=={version}' + ('' if everywhere else f' ; {marker}')


def main(arguments: list[str]) -> int:
    """Print the lock of the requirements file for the interpreters that follow it."""
    requirements, *pythons = arguments
    resolved = {minor(python): resolve(python, requirements) for python in pythons}
    print(f'# Made by `make lock` from {requirements}; do not edit.')
    print('\n'.join(lines(resolved)))
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
