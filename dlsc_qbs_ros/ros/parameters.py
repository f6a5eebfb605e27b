"""The package's parameters as ROS parameters of a node."""

from __future__ import annotations

from typing import Any, Callable

from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult)
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..config import Config, PARAMETERS
from ..declaration import checked
from ..errors import ConfigError
from ..profiles import is_ros_parameter


class NodeParameters:
    """
    The sections of the configuration that a node declares, from what it was started with on.

    Before `load` each parameter takes any value of its own range; the whole is checked then.
    After it only `live` ones change, and only to a configuration that is sound as a whole:
    `on_change` is given that one, once for all that were set together.

    One YAML file serves all nodes, so keys of other sections are known and checked too.
    """

    def __init__(self, node: Node, sections: tuple[str, ...],
                 on_change: Callable[[Config], None]):
        # What was given is only public once declared, and an empty list cannot be declared
        # untyped.
        self._given = {name: () if override.value is None else override.value
                       for name, override in node._parameter_overrides.items()
                       if not is_ros_parameter(name)}
        self._config: Config | None = None
        self._on_change = on_change
        for name in PARAMETERS:
            if name.partition('.')[0] in sections:
                node.declare_parameter(name, _ros_value(self._declarable(name)),
                                       _descriptor(PARAMETERS[name]), ignore_override=True)
        node.add_on_set_parameters_callback(self._judge)
        node.add_post_set_parameters_callback(self._take_over)

    def load(self) -> Config:
        """
        Return the configuration as it stands, and hold the node to it.

        Raises
        ------
        ConfigError
            When a key is unknown, or a value of the wrong type or out of range.

        """
        self._config = Config().override(self._given)
        return self._config

    def release(self) -> None:
        """Let any parameter change again."""
        self._config = None

    def _declarable(self, name: str) -> Any:
        """Return what was given; its default instead of what `load` will refuse."""
        try:
            return checked(name, self._given[name], PARAMETERS[name])
        except (KeyError, ConfigError):
            return PARAMETERS[name].default

    def _judge(self, parameters: list[Parameter]) -> SetParametersResult:
        changes = _ours(parameters)
        try:
            if self._config is not None:
                self._config.retuned(changes)
            for name, value in changes.items():
                checked(name, value, PARAMETERS[name])
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_over(self, parameters: list[Parameter]) -> None:
        changes = _ours(parameters)
        self._given.update(changes)
        if self._config is not None and changes:
            self._config = self._config.retuned(changes)
            self._on_change(self._config)


def _ours(parameters: list[Parameter]) -> dict[str, Any]:
    return {parameter.name: parameter.value for parameter in parameters
            if parameter.name in PARAMETERS}


def _ros_value(value: Any) -> Any:
    """Return the value as rclpy takes it; of an empty list it could not tell the type."""
    if isinstance(value, tuple):
        return list(value) or Parameter.Type.STRING_ARRAY
    return value


def _descriptor(spec) -> ParameterDescriptor:
    unit, bounds, choices = (spec.metadata[key] for key in ('unit', 'bounds', 'choices'))
    descriptor = ParameterDescriptor(
        description=spec.metadata['meaning'] + (f' [{unit}]' if unit else ''),
        additional_constraints=f'one of {", ".join(choices)}' if choices else '')
    if bounds and isinstance(spec.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(bounds[0]), to_value=float(bounds[1]))]
    elif bounds:
        descriptor.integer_range = [IntegerRange(from_value=bounds[0], to_value=bounds[1])]
    return descriptor
