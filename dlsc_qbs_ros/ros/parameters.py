"""The package's parameters as ROS parameters of a node."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..config import Config, PARAMETERS, is_ros_parameter


def load_config(node: Node, sections: tuple[str, ...]) -> Config:
    """
    Return the configuration a node was started with; declare its sections on the node.

    One YAML file serves all nodes, so keys of other sections are known and checked too. Declared
    parameters are read-only: nothing of the pipeline can change its shape in flight.

    Raises
    ------
    ConfigError
        When a key is unknown, or a value of the wrong type or out of range.

    """
    # What was given is only public once declared, and an empty list cannot be declared untyped.
    given = {name: () if override.value is None else override.value
             for name, override in node._parameter_overrides.items()
             if not is_ros_parameter(name)}
    config = Config().override(given)
    for name, value in config.flat().items():
        if name.partition('.')[0] in sections:
            node.declare_parameter(
                name, _ros_value(value), _descriptor(PARAMETERS[name]), ignore_override=True)
    return config


def _ros_value(value: Any) -> Any:
    """Return the value as rclpy takes it; of an empty list it could not tell the type."""
    if isinstance(value, tuple):
        return list(value) or Parameter.Type.STRING_ARRAY
    return value


def _descriptor(spec) -> ParameterDescriptor:
    unit, bounds, choices = (spec.metadata[key] for key in ('unit', 'bounds', 'choices'))
    descriptor = ParameterDescriptor(
        description=spec.metadata['meaning'] + (f' [{unit}]' if unit else ''),
        additional_constraints=f'one of {", ".join(choices)}' if choices else '',
        read_only=True)
    if bounds and isinstance(spec.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(bounds[0]), to_value=float(bounds[1]))]
    elif bounds:
        descriptor.integer_range = [IntegerRange(from_value=bounds[0], to_value=bounds[1])]
    return descriptor
