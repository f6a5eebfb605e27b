"""What the tools share: their exit code, reading --config and --set, writing into --out."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
import sys
from typing import Any, Callable, Iterable, Iterator

from ..config import Config
from ..errors import DlscQbsError
from ..profiles import load_profile, parse_assignment, to_yaml


def run_tool(name: str, work: Callable[[Any], None], options: Any) -> int:
    """Do a tool's work; print an expected error as one line and return the exit code."""
    try:
        work(options)
    except DlscQbsError as error:
        print(f'{name}:', ' '.join(str(error).split()), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


def given_values(profile: Path | None, assignments: Iterable[str]) -> dict[str, Any]:
    """Return the parameters of --config, overridden by those of --set."""
    values: dict[str, Any] = load_profile(profile) if profile else {}
    values.update(map(parse_assignment, assignments))
    return values


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Turn the failure of any write into --out into an expected error."""
    try:
        yield
    except OSError as error:
        raise DlscQbsError(f'--out {out}: cannot be written: {error}') from error


def write_config(out: Path, config: Config, notes: Iterable[str]) -> None:
    """Make the folder and write the effective configuration, before any long work, into it."""
    comments = ''.join(f'# {note}\n' for note in notes)
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        (out / 'config.yaml').write_text(comments + to_yaml(config))
