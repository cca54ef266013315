"""Host in virtual time, for the tests of the simulated remote."""

from __future__ import annotations

from cardan.sim_peers.base import parse_script
from cardan_wiimote.peer import SCRIPT_VERBS, ScriptedWiimote, SimulatedWiimote
from cardan_wiimote.protocol import (
    Data,
    DataMode,
    InputReport,
    Interleaved,
    OutputReport,
    ReadData,
    ReadMemory,
    decode_input,
    encode_output,
)

Stamped = list[tuple[float, InputReport]]


class Host:
    """Exchanges reports with a remote and advances the time."""

    def __init__(self, script: str = "", extension: str = "", **settings: object) -> None:
        self.remote = SimulatedWiimote(extension=extension, **settings)  # type: ignore[arg-type]
        self.motion = ScriptedWiimote(parse_script(script, SCRIPT_VERBS), extension)
        self.now_s = 0.0
        assert self.remote.connect(0.0)
        self.remote.reports(0.0)

    def run(self, seconds: float) -> Stamped:
        """Return every report of the next `seconds` with its time."""
        until_s = self.now_s + seconds
        came: Stamped = []
        while (due_s := min(self.remote.next_due_s, self.motion.next_due_s)) <= until_s:
            if self.motion.next_due_s <= due_s:
                self.motion.advance(due_s, self.remote)
            came += [(due_s, decode_input(report)) for report in self.remote.reports(due_s)]
        came += [(until_s, decode_input(report)) for report in self.remote.reports(until_s)]
        self.now_s = until_s
        return came

    def send(self, value: OutputReport | bytes) -> list[InputReport]:
        """Send an output report; return the immediate reports."""
        report = value if isinstance(value, bytes) else encode_output(value)
        self.remote.output(report, self.now_s)
        return [decode_input(reply) for reply in self.remote.reports(self.now_s)]

    def stream(self, mode: int, seconds: float, *, continuous: bool = True) -> list[Data]:
        """Set a data mode and collect its reports."""
        first = self.send(DataMode(mode, continuous))
        values = first + [value for _, value in self.run(seconds)]
        return [value for value in values if isinstance(value, Data)]

    def read(self, address: int, size: int, space: int = 1) -> bytes | int:
        """Read memory; return the data or the error."""
        values = self.send(ReadMemory(address, size, space))
        values += [value for _, value in self.run(0.02 + 0.012 * (size / 16))]
        pieces = [value for value in values if isinstance(value, ReadData)]
        assert pieces, values
        if pieces[-1].error:
            return pieces[-1].error
        assert [piece.address for piece in pieces] == [
            (address & 0xFFFF) + 16 * index for index in range(len(pieces))
        ]
        return b"".join(piece.data for piece in pieces)


def without_data(reports: Stamped) -> list[InputReport]:
    return [value for _, value in reports if not isinstance(value, Data | Interleaved)]
