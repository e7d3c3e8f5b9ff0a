"""Network access to a run: the endpoint that cells join, and the endpoint for listeners and operators."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, final

from bus.errors import TransportError
from bus.wire.keys import message_kinds
from deploy.control.client import runs_at
from deploy.errors import InputError
from deploy.security.policy import open_gate
from deploy.util.formatting import say
from deploy.workers.connecting import connect_patiently
from deploy.workers.listening import Option, check_opened, loopback_address, socket_in
from deploy.workers.socket_folder import SocketFolder

if TYPE_CHECKING:
    from bus.spec import StallSpec
    from bus.transports.zenoh import Mirror, ZenohEndpoint
    from bus.transports.zenoh.requests import RequestQueue
    from deploy.security.keyring import Keyring
    from deploy.workers.plan import Plan, RunOptions

_AGAIN_S: Final = 0.1
_FORGOTTEN_S: Final = 1.0
"""Wall time beyond a dead plant's lease after which its token is gone for certain, s."""
_TICKS: Final = 64
"""Most ticks whose messages may wait to be copied for listeners; the oldest messages are dropped first."""


@final
class Access:
    """Both endpoints of a run, for the processes of cells and for listeners and operators.

    The endpoint for listeners and operators accepts only operators' requests, which the plant answers. No message from
    there reaches the cells.

    Args:
        plan: Plan of the run.
        stall: Deadlines.
        options: Options of the run, for the endpoints and ``insecure``.
        keyring: Keys of the run; None: any peer may listen and send requests.

    Attributes:
        join: Endpoint to which the processes of cells connect.
        locator: Endpoint to which listeners and operators connect.
    """

    def __init__(self, plan: Plan, stall: StallSpec, options: RunOptions, keyring: Keyring | None) -> None:
        self._plan = plan
        self._stall = stall
        self._lease_s = stall.lease_s
        self._options = options
        self._keyring = keyring
        self._folder: SocketFolder | None = None
        self._mirror: Mirror | None = None
        self._asked: list[ZenohEndpoint] = []
        """Endpoints at which operators' requests are taken."""
        self.join = ""
        self.locator = ""

    def open(self, check: Callable[[], None] | None = None) -> ZenohEndpoint:
        """Open both endpoints; or connect to the router, which carries cells, listeners and operators.

        Args:
            check: Called while the router is waited for; may raise to end the wait.

        Returns:
            The plant's endpoint for the cells; the caller closes it after closing this object.

        Raises:
            InputError: A port is in use, or an endpoint is invalid or reachable from more than is allowed.
            DeployError: No router listens in time.
        """
        if self._options.router is not None:
            hub = self._connected(self._options.router, check)
        else:
            hub = self._listening()
        if self._mirror is not None:
            self._asked.append(self._mirror.outside)
        if self._options.external:
            self._asked.append(hub)
        return hub

    def _connected(self, router: str, check: Callable[[], None] | None) -> ZenohEndpoint:
        """Connect to a router."""
        identity = None if self._keyring is None else self._keyring.plant_as_client()
        self.join = self.locator = router
        hub = connect_patiently(router, self._stall, identity, "the plant", say, check=check, plant=True)
        try:
            self._check_alone(hub, router, check)
        except BaseException:
            hub.close()
            raise
        return hub

    def _check_alone(self, hub: ZenohEndpoint, router: str, check: Callable[[], None] | None) -> None:
        """Refuse the name of another plant's run; a killed plant's token goes after its lease.

        Raises:
            InputError: There is one, and cells would take both for the same.
        """
        run, until = self._plan.run, time.monotonic() + self._lease_s + _FORGOTTEN_S
        while run in runs_at(hub):
            if time.monotonic() > until:
                raise InputError(
                    f"--connect {router}: a run {run} is there already: --run NAME gives this one another name"
                )
            if check is not None:
                check()
            time.sleep(_AGAIN_S)

    def _listening(self) -> ZenohEndpoint:
        """Open both endpoints."""
        from bus.transports.zenoh import Mirror, open_hub, open_outside

        keyring, options, plan = self._keyring, self._options, self._plan
        join = options.join
        if join is None and keyring is None and (not options.external or options.cluster is not None):
            self._folder = SocketFolder()
            join = socket_in(str(self._folder.path))
        gate = None if keyring is None else keyring.gate(operators=options.external)
        outer = open_gate() if keyring is None else keyring.outer_gate()
        joining: Option = "--listen" if options.external and options.cluster is None else "--join"
        hub = self._opened(joining, lambda: open_hub(join, lease_s=self._lease_s, gate=gate))
        try:
            outside = self._opened(
                "--listen", lambda: open_outside(options.listen, lease_s=self._lease_s, gate=outer)
            )
        except InputError:
            hub.close()
            raise
        if hub.refusals is not None:
            hub.refusals.names.append(outside.role)
        units = len(plan.partition.lattice) if plan.wire == "per_cell" else plan.partition.count
        kinds = message_kinds(plan.run, plan.wire, units)
        self._mirror = Mirror(
            hub, outside, {key: _TICKS * number for key, number in kinds.items()}, f"mdms/{plan.run}/**"
        )
        self.join, self.locator = loopback_address(hub.locator), loopback_address(outside.locator)
        return hub

    def questions(self, key: str) -> RequestQueue:
        """Open the queue of operators' requests on ``key``."""
        from bus.transports.zenoh.requests import RequestQueue

        assert self._asked, "this is a bug: not open"
        return RequestQueue(key, *self._asked)

    def close(self) -> None:
        """Close the endpoint for listeners and operators, and remove the folder of the other's socket."""
        if self._mirror is not None:
            self._mirror.close()
        if self._folder is not None:
            self._folder.close()

    def _opened(self, option: Option, opens: Callable[[], ZenohEndpoint]) -> ZenohEndpoint:
        """Open an endpoint, and refuse an endpoint that is reachable from more than is allowed."""
        try:
            endpoint = opens()
        except TransportError as error:
            raise InputError(str(error)) from None
        kind = None if self._keyring is None else self._keyring.about.kind
        try:
            check_opened(
                endpoint.locator, endpoint.listening, kind, insecure=self._options.insecure, option=option
            )
        except InputError:
            endpoint.close()
            raise
        return endpoint
