"""Shared control: filters of the operator's twist between the mapping and the reference."""

from cardan.gateway.operator.filters.base import (
    TwistFilter as TwistFilter,
)
