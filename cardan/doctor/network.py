"""Checks of the bus: its peers, and the settings of ROS 2 programs of this shell."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from cardan.bus.discovery import Discovery, discover, reachable, remedies
from cardan.bus.options import BusOptions
from cardan.bus.router import is_served, router_address
from cardan.doctor.base import Check, Finding, Subject, caution, failure, good
from cardan.errors import CardanError, ExtraMissingError, install_command

GROUP = "network"

ZENOH = "rmw_zenoh_cpp"


def check_bus(
    options: BusOptions,
    who: str,
    look: Callable[[BusOptions], Discovery] = discover,
    served: Callable[[tuple[str, int]], bool] = is_served,
) -> Finding:
    """Check that the bus of `who` has peers. It is joined only if a router runs here or is
    configured elsewhere: a session starts the router of its own computer."""
    options = reachable(options)
    where = options.zenoh_config or options.router or "no router"
    address = router_address(options)
    if address is not None and not served(address):
        return good("bus", f"{who}: no router at {where} yet; a session with [network] starts it")
    try:
        found = look(options)
    except CardanError as error:
        why = f"{who} cannot join the bus"
        missing = isinstance(error, ExtraMissingError)
        mend = install_command("network") if missing else "cardan net list"
        return failure("bus", f"{where}: {error}", why, mend)
    if advice := remedies(options, found):
        return caution(
            "bus",
            f"{who}: {advice[0]}",
            "no node is found there",
            " ".join(advice[1:]) or ("start the nodes, then: cardan net list"),
        )
    return good("bus", f"{who}: {len(found.nodes)} nodes are found at {where}")


def check_environment(
    environment: Mapping[str, str], buses: Mapping[BusOptions, str]
) -> Iterator[Finding]:
    """Check that ROS 2 programs started in this shell meet the sessions of the files."""
    chosen, distribution = environment.get("RMW_IMPLEMENTATION", ""), environment.get("ROS_DISTRO")
    if chosen == ZENOH or not (chosen or distribution):
        yield good(
            "rmw", f"RMW_IMPLEMENTATION is {chosen or 'not set, and no ROS 2 is set up here'}"
        )
    else:
        yield caution(
            "rmw",
            f"RMW_IMPLEMENTATION is {chosen or 'not set'}",
            "ROS 2 programs of this shell use DDS, and find no session on Zenoh",
            f"export RMW_IMPLEMENTATION={ZENOH}",
        )
    domain = environment.get("ROS_DOMAIN_ID", "").strip() or "0"
    others = {str(options.domain): who for options, who in buses.items()}
    if domain in others or not others:
        yield good("domain", f"ROS_DOMAIN_ID is {domain}")
        return
    other, who = next(iter(others.items()))
    yield caution(
        "domain",
        f"ROS_DOMAIN_ID is {domain}, and {who} has the domain {other}",
        "nodes of different domains do not meet",
        f"export ROS_DOMAIN_ID={other}",
    )


class Bus(Check):
    """Bus of each session: its router and its nodes."""

    group, tells = GROUP, ("bus",)

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        looked: set[BusOptions] = set()
        for options, who in subject.buses().items():
            if (key := reachable(options)) not in looked:
                looked.add(key)
                yield check_bus(options, who)


class RosEnvironment(Check):
    """Environment variables of ROS 2."""

    group, tells = GROUP, ("rmw", "domain")

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        if not (buses := subject.buses()):
            return []
        return check_environment(subject.environment, buses)
