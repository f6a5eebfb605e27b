"""A managed node: configured, activated, deactivated and cleaned up as it is told to."""

from __future__ import annotations

from contextlib import ExitStack
import traceback
from typing import Callable

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from .diagnostics import ERROR, OK, publish_diagnostics
from .logging import forward_logging
from .parameters import NodeParameters
from .stale_ports import stale_ports_avoided
from ..config import Config
from ..errors import DlscQbsError

SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
ENTITIES = ('publisher', 'subscription', 'service', 'client', 'timer')
EXPECTED = (DlscQbsError, ParameterException)  # rclpy's own: use_sim_time := 3


class ManagedNode(LifecycleNode):
    """
    A node with the life of a ROS 2 managed node.

    A node class makes in `configure` what its parameters shape, and in `activate` what runs:
    subscriptions and timers. Publishers, subscriptions, services, clients, timers and attributes
    made there go when the node is cleaned up or deactivated; what else is to be given back then
    is put on the `undo` stack, which unwinds last in, first out, before they go. So each step is
    taken back whole, also one that fails half-way.
    """

    def __init__(self, name: str, sections: tuple[str, ...], **options):
        with stale_ports_avoided():  # for the first node makes the process's participant
            super().__init__(name, **options)
        forward_logging(self)
        self.declare_parameter('autostart', True, ParameterDescriptor(
            description='configure and activate as soon as the node is there', read_only=True))
        self._settings = NodeParameters(self, sections, self.reconfigure)
        self._configured, self._active = ExitStack(), ExitStack()
        self._state = 'unconfigured'
        self._failure: Exception | None = None
        self._is_starting = False
        publish_diagnostics(self, self._report_in_any_state)

    def configure(self, config: Config, undo: ExitStack) -> None:
        """Make what the parameters shape; raise DlscQbsError where they cannot be."""
        raise NotImplementedError

    def activate(self, undo: ExitStack) -> None:
        """Begin to work."""
        raise NotImplementedError

    def reconfigure(self, config: Config) -> None:
        """Go on with other values of `live` parameters."""

    def report(self) -> tuple[bytes, str, dict[str, object]]:
        """Return (level, message, values) for diagnostics, while active."""
        raise NotImplementedError

    def start(self) -> None:
        """Configure and activate, if `autostart` says so; raise what hinders it."""
        if not self.get_parameter('autostart').value:
            return
        self._is_starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != SUCCESS:
                raise self._failure
        self._is_starting = False

    def destroy_node(self) -> None:
        """Stop working, give everything back and end; raise what went wrong over that."""
        self._failure = None
        try:
            if self._state in ('inactive', 'active'):
                self.trigger_shutdown()
            if self._failure is not None:
                raise self._failure
        finally:
            super().destroy_node()

    def on_configure(self, state) -> TransitionCallbackReturn:
        """Configure with the parameters as they are; stay unconfigured where they do not fit."""
        return self._transition(self._configure, 'inactive', FAILURE)

    def on_activate(self, state) -> TransitionCallbackReturn:
        """Begin to work."""
        return self._transition(self._activate, 'active', FAILURE)

    def on_deactivate(self, state) -> TransitionCallbackReturn:
        """Stop working and keep what there is."""
        return self._transition(self._active.close, 'inactive')

    def on_cleanup(self, state) -> TransitionCallbackReturn:
        """Give everything back."""
        return self._transition(self._give_back, 'unconfigured')

    def on_shutdown(self, state) -> TransitionCallbackReturn:
        """Stop working and give everything back."""
        return self._transition(self._give_back, 'finalized')

    def on_error(self, state) -> TransitionCallbackReturn:
        """Give everything back after a step that went wrong."""
        return self._transition(self._give_back, 'unconfigured')

    def _transition(self, step: Callable[[], None], state: str,
                    if_expected: TransitionCallbackReturn = TransitionCallbackReturn.ERROR
                    ) -> TransitionCallbackReturn:
        try:
            step()
        except Exception as error:  # rclpy would not even log it
            is_expected = isinstance(error, EXPECTED)
            self._failure = error
            if not self._is_starting:  # else the process ends with it
                self.get_logger().error(str(error) if is_expected else traceback.format_exc())
            return if_expected if is_expected else TransitionCallbackReturn.ERROR
        self._state = state
        return SUCCESS

    def _configure(self) -> None:
        with ExitStack() as undo:
            undo.callback(self._forget_all_but, set(vars(self)), self._entities())
            undo.callback(self._settings.release)
            self.configure(self._settings.load(), undo)
            self._configured = undo.pop_all()
        self._failure = None

    def _activate(self) -> None:
        with ExitStack() as undo:
            undo.callback(self._forget_all_but, set(vars(self)), self._entities())
            self.activate(undo)
            self._active = undo.pop_all()

    def _give_back(self) -> None:
        self._active.close()
        self._configured.close()

    def _entities(self) -> dict[str, set]:
        return {kind: set(getattr(self, f'{kind}s')) for kind in ENTITIES}

    def _forget_all_but(self, attributes: set[str], entities: dict[str, set]) -> None:
        for kind, present in self._entities().items():
            for entity in present - entities[kind]:
                getattr(self, f'destroy_{kind}')(entity)
        for attribute in vars(self).keys() - attributes:
            delattr(self, attribute)

    def _report_in_any_state(self) -> tuple[bytes, str, dict[str, object]]:
        if self._state == 'active':
            return self.report()
        if self._failure is not None:
            return ERROR, f'{self._state}: {self._failure}', {}
        return OK, self._state, {}
