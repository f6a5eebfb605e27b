"""The packet in the pose cells, and how views that are seen again move it."""

from __future__ import annotations

import numpy as np

from ..config import PoseCellsConfig
from ..core.pose_cells import PoseCells
from ..core.rows import Rows
from ..core.types import Pose2

# The exponent from which on a view cell has no power left.
SPENT = np.log(30.0)


class Packet:
    """
    The pose cells, and where their packet was at every view cell and experience.

    A view cell that is seen again injects activity where the packet was when the cell was made;
    that spends its power, which it regains at rest.

    Attributes
    ----------
    cells : PoseCells

    """

    def __init__(self, config: PoseCellsConfig):
        self._config = config
        self.cells = PoseCells(config)
        # Per view cell: where the packet was, and how spent it is. Per experience: where it was.
        self._at_view_cell = Rows(np.zeros((0, 3)))
        self._decay = Rows(np.zeros(0))
        self._at_experience = Rows(np.zeros((0, 3)))

    def state(self) -> dict[str, np.ndarray]:
        """Return what `restore` takes, by the names in `map_state.ARRAYS`."""
        return {
            'experience_pose_cells': self._at_experience.values.copy(),
            'view_cell_pose_cells': self._at_view_cell.values.copy(),
            'view_cell_decays': self._decay.values.copy(),
            'pose_cells': self.cells.activity.copy()}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Go on from what `state` returned."""
        self._at_experience = Rows(state['experience_pose_cells'].copy())
        self._at_view_cell = Rows(state['view_cell_pose_cells'].copy())
        self._decay = Rows(state['view_cell_decays'].copy())
        self.cells.activity = state['pose_cells'].copy()

    def step(self, motion: Pose2) -> None:
        """Let the packet go along with a motion, and view cells rest."""
        self.cells.step(motion)
        np.maximum(self._decay.values - self._config.restore, self._config.active_decay,
                   out=self._decay.values)

    def place(self, experience: int) -> None:
        """Move the packet to where it was at an experience."""
        self.cells.place(self._at_experience.values[experience])

    def distance(self, experiences: np.ndarray) -> np.ndarray:
        """Return how far, in cells, the packet is from where it was at experiences (n,)."""
        return self.cells.distance(self._at_experience.values[experiences], self.cells.position())

    def add_experience(self) -> None:
        """Keep where the packet is for a new experience."""
        self._at_experience.append(self.cells.position())

    def add_view_cell(self) -> None:
        """Keep where the packet is for a new view cell."""
        self._at_view_cell.append(self.cells.position())
        self._decay.append(self._config.active_decay)

    def spend(self, view_cell: int) -> float:
        """Return the energy that a view cell has power for, not always above 0, and spend it."""
        spent = min(1.2 * self._decay.values[view_cell], SPENT)
        energy = self._config.injection * (30.0 - np.exp(spent)) / 30.0
        self._decay.values[view_cell] += self._config.active_decay
        return energy

    def inject(self, view_cell: int, turn_rad: float, energy: float) -> None:
        """Add activity where the packet was at a view cell, with its heading turned."""
        self.cells.inject(
            self.cells.turned(self._at_view_cell.values[view_cell], turn_rad), energy)
