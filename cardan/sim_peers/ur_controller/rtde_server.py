"""The RTDE server of the simulated controller: one object for each client."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

from cardan.protocols.ur.rtde import (
    IN_USE,
    NOT_FOUND,
    VERSIONS,
    ControlRequest,
    Data,
    MalformedPayload,
    PacketReader,
    PacketType,
    Recipe,
    RecipeSetup,
    SetupReply,
    TextLevel,
    TextMessage,
    read_request,
    reply_accepted,
    reply_setup,
    reply_version,
    text,
)
from cardan.protocols.ur.variables import LATER
from cardan.sim_peers.ur_controller.controller import UrController
from cardan.sim_peers.ur_controller.telemetry import Telemetry

MOST_RECIPES: Final = 255


class Claims:
    """Write access of clients to variables, and the shared state of all clients."""

    def __init__(self, faults: Mapping[str, float]) -> None:
        self._owners: dict[str, object] = {}
        self._in_use = faults.get("in-use", 0.0) > 0.0
        """True if a fieldbus uses all variables."""
        self._shared = faults.get("shared-inputs", 0.0) > 0.0
        self._retains_inputs = faults.get("stale-inputs", 0.0) > 0.0
        self.foreign = 0
        """Number of clients that spoke another protocol."""

    def taken(self, name: str, by: object) -> bool:
        """Return True if another client, or a fieldbus, has it."""
        other = self._owners.get(name, by) is not by
        return self._in_use or (other and not self._shared)

    def take(self, names: tuple[str, ...], by: object) -> None:
        """Assign these variables to `by`."""
        self._owners.update(dict.fromkeys(names, by))

    def release(self, by: object) -> None:
        """Release the variables of `by`, which has left."""
        if not self._retains_inputs:
            self._owners = {name: owner for name, owner in self._owners.items() if owner is not by}


class RtdeClient:
    """Connection of a client: call `data` with received bytes; `send` takes replies."""

    def __init__(
        self,
        controller: UrController,
        telemetry: Telemetry,
        claims: Claims,
        send: Callable[[bytes], None],
        note: Callable[[str], None],
    ) -> None:
        """`note` takes messages for the user."""
        self._controller, self._telemetry, self._claims = controller, telemetry, claims
        self._send, self._note = send, note
        self._reader = PacketReader()
        faults = controller.options.faults
        self._versions = VERSIONS[1:] if faults.get("no-version-1", 0.0) else VERSIONS
        self._known = telemetry.outputs
        if faults.get("fewer-outputs", 0.0):
            self._known = {n: kind for n, kind in telemetry.outputs.items() if n not in LATER}
        self._version = 0
        """Protocol version; 0: not agreed on."""
        self._met = False
        """A packet has arrived."""
        self._started = False
        self._outputs: list[tuple[Recipe, int]] = []
        """Output recipes, each with the number of frames from one package to the next."""
        self._inputs: dict[int, Recipe] = {}
        self.failure = ""
        """Reason to close the connection; empty: none."""

    def data(self, data: bytes) -> None:
        """Handle received bytes."""
        self._reader.feed(data)
        if not self._met and self._reader.foreign_request:
            self._claims.foreign += 1
            self.failure = f"the client does not speak RTDE ({self._claims.foreign} so far)"
            return
        while not self.failure and (found := self._reader.take()) is not None:
            self._met = True
            self._take(*found)
        if self._reader.failure and not self.failure:
            self.failure = self._reader.failure
            self._tell(self.failure, TextLevel.ERROR)

    def gone(self) -> None:
        """Handle the end of the connection."""
        self._claims.release(self)

    def packages(self, frame: int) -> list[bytes]:
        """Return the data packages of a frame."""
        if not self._started:
            return []
        value = self._telemetry.value
        return [
            recipe.pack([value(name) for name in recipe.names])
            for recipe, every in self._outputs
            if frame % every == 0
        ]

    # -- requests ---------------------------------------------------------------------------------

    def _take(self, kind: int, payload: bytes) -> None:
        asked = read_request(kind, payload, self._version)
        if isinstance(asked, MalformedPayload):
            self._tell(f"package {kind}: {asked.reason}", TextLevel.ERROR)
        elif isinstance(asked, Data):
            self._write(asked)
        elif isinstance(asked, RecipeSetup):
            self._send(reply_setup(self._set_up(asked), self._version))
        elif isinstance(asked, ControlRequest):
            self._answer(asked)
        else:
            assert isinstance(asked, TextMessage)  # A client's text for the log is dropped.

    def _answer(self, asked: ControlRequest) -> None:
        if asked.kind is PacketType.PROTOCOL_VERSION:
            self._version = asked.version if asked.version in self._versions else 0
            self._send(reply_accepted(asked.kind, self._version > 0))
        elif asked.kind is PacketType.CONTROLLER_VERSION:
            self._send(reply_version(self._controller.options.version))
        elif asked.kind is PacketType.START:
            self._started = bool(self._outputs)
            self._send(reply_accepted(asked.kind, self._started))
        else:
            self._started = False
            self._send(reply_accepted(asked.kind, True))

    def _set_up(self, asked: RecipeSetup) -> SetupReply:
        outputs = asked.kind is PacketType.OUTPUTS
        known = self._known if outputs else self._telemetry.writable
        types = tuple(known.get(name, NOT_FOUND) for name in asked.names)
        refused = SetupReply(asked.kind, 0, types)
        if not self._version:
            self._tell("protocol version 1 or version 2 has to be agreed on first", TextLevel.ERROR)
            return refused
        if not outputs:
            types = tuple(
                IN_USE if self._claims.taken(name, self) and kind != NOT_FOUND else kind
                for name, kind in zip(asked.names, types, strict=True)
            )
            refused = SetupReply(asked.kind, 0, types)
        wrong = [
            f"{name} {kind}"
            for name, kind in zip(asked.names, types, strict=True)
            if kind in (NOT_FOUND, IN_USE)
        ]
        if wrong or not types:
            self._note(f"recipe refused: {', '.join(wrong) or 'it is empty'}")
            return refused
        number = len(self._outputs) + 1 if outputs else len(self._inputs) + 1
        if number > MOST_RECIPES:
            return refused
        if outputs:
            rate_hz = self._controller.options.rate_hz
            asked_hz = rate_hz if self._version == 1 else asked.frequency_hz
            if not 1.0 <= asked_hz <= rate_hz:
                self._tell(f"{asked_hz:g} Hz is not 1 to {rate_hz:g} Hz", TextLevel.ERROR)
                return SetupReply(asked.kind, 0, types)
            recipe = Recipe(None if self._version == 1 else number, asked.names, types)
            self._outputs.append((recipe, math.floor(rate_hz / asked_hz + 1e-9)))
        else:
            self._claims.take(asked.names, self)
            self._inputs[number] = Recipe(number, asked.names, types)
        return SetupReply(asked.kind, number, types)

    def _write(self, data: Data) -> None:
        recipe = self._inputs.get(data.recipe)
        if recipe is None:
            self._tell(f"there is no input recipe {data.recipe}", TextLevel.ERROR)
            return
        values = recipe.unpack(data.values)
        if values is None:
            self._tell(
                f"recipe {data.recipe} has {recipe.size} bytes, not {len(data.values)}",
                TextLevel.ERROR,
            )
            return
        self._telemetry.write(values)

    def _tell(self, words: str, level: TextLevel) -> None:
        self._send(text(words, "Controller", level, self._version))
