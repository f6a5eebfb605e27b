"""What makes a flight harder than plain laps."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import ConfigError

ALTITUDE_M = 1.4
RANGES = {'second_altitude_m': (0.6, 3.3), 'pause_s': (0.0, 600.0), 'dimmed_to': (0.05, 1.0)}


@dataclass(frozen=True)
class Variations:
    """
    What happens on a flight besides its laps, any of it together; by default nothing does.

    Attributes
    ----------
    second_altitude_m : float
        Height of every other lap, the second being the first of them; below the shelves' top.
    reversed_lap : bool
        The second lap is flown the other way round, the camera looking along the motion. The
        drone stops and turns round before it and after it.
    pause_s : float
        How long the drone hovers in mid-flight.
    dimmed_to : float
        What stays of the hall's light from half-way on, as a share.
    twin_aisle : bool
        The aisles between the shelves are painted alike, and so are the walls at their ends: what
        the camera sees in the second one, flown westward as always, is what it sees in the first
        one, flown eastward.

    Raises
    ------
    ConfigError
        If a value is out of its range.

    """

    second_altitude_m: float = ALTITUDE_M
    reversed_lap: bool = False
    pause_s: float = 0.0
    dimmed_to: float = 1.0
    twin_aisle: bool = False

    def __post_init__(self):
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f'{name} = {value}: expected a value in [{low:g}, {high:g}]')


PLAIN = Variations()

# Each alone, as strong as `simulate` makes it unless told otherwise.
EACH = {
    'second_altitude': Variations(second_altitude_m=2.2),
    'reversed_lap': Variations(reversed_lap=True),
    'pause': Variations(pause_s=20.0),
    'dimmed': Variations(dimmed_to=0.4),
    'twin_aisle': Variations(twin_aisle=True),
}
