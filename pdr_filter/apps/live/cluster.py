"""Actors of a Dask cluster, which serve shares of the devices on other machines.

Dask keeps no copy of an actor. When its worker dies, an actor is created again at another worker, from the folder of
the sessions, so all machines need to see the same folder. Only requests of the server make an actor write, so an actor
that was given up and still lives writes nothing more.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pdr_filter.apps.batch.worker_process import DASK_CONNECT_S, LostError, dask_errors
from pdr_filter.apps.live.parts import Command, Part, Request, Response
from pdr_filter.apps.live.settings import Settings

# A worker whose machine has lost its power breaks no connection.
_ANSWER_S = 60.0
# How often it is looked whether a worker that has not answered is still there.
_LOOK_S = 0.5


class DaskCluster:
    """Dask cluster whose workers run the filters. The caller must trust it: its workers run code of the server."""

    def __init__(self, scheduler: str, settings: Settings, folder: Path) -> None:
        self._scheduler, self._settings, self._folder = scheduler, settings, folder.resolve()
        self._client: Any = None

    async def connect(self) -> None:
        """Return when the scheduler has answered; ValueError if it does not."""
        with dask_errors(self._scheduler):
            from distributed import Client

            # an actor finds its way by the client that is the default
            made: Any = Client(self._scheduler, asynchronous=True, direct_to_workers=True, timeout=DASK_CONNECT_S)
            self._client = await made

    async def start(self, part: int, n_parts: int) -> Actor:
        """Start share number `part` of `n_parts` of the devices on one of the workers, which are chosen in turn.

        LostError if there is no worker or if it dies. ValueError if the worker does not see the folder.
        """
        addresses = sorted(await self._client.nthreads())
        if not addresses:
            raise LostError(f"no worker at {self._scheduler}: start one with dask worker")
        address = addresses[part % len(addresses)]
        future = self._client.submit(
            Part,
            self._settings,
            self._folder,
            part,
            n_parts,
            actor=True,
            pure=False,
            workers=[address],
            allow_other_workers=True,  # a worker that has just died may still be listed
        )
        try:
            return Actor(future, await future, address)
        except ValueError:
            raise
        except Exception as error:  # the worker may have died meanwhile, which raises many kinds
            raise LostError(f"{address}: {error}") from error

    async def close(self) -> None:
        """Disconnect from the cluster."""
        if self._client is not None:
            await self._client.close()


class Actor:
    """Actor on a Dask worker that serves a share of the devices (implements `Share`)."""

    def __init__(self, future: Any, actor: Any, address: str) -> None:
        self._future = future  # the actor lives as long as this reference
        self._actor, self._address = actor, address

    async def ask(self, requests: Sequence[Request]) -> list[Response]:
        """Return an answer to each request. LostError if the worker is gone or does not answer within 60 s."""
        asked = asyncio.create_task(self._asked(requests))
        until = time.monotonic() + _ANSWER_S
        while not asked.done():
            await asyncio.wait([asked], timeout=_LOOK_S)
            # the scheduler knows it at once, the connection only after half a minute of trying
            if self._future.status != "finished" or time.monotonic() > until:
                break
        if not asked.done():
            asked.cancel()
            raise LostError(f"dask worker {self._address} is gone or does not answer: start it again")
        return asked.result()

    async def _asked(self, requests: Sequence[Request]) -> list[Response]:
        try:
            return await self._actor.answer(list(requests))
        except Exception as error:  # a lost worker raises many kinds
            raise LostError(f"dask worker {self._address} is gone or failed ({error}): start it again") from error

    async def close(self) -> None:
        """Save all sessions and end the actor."""
        await self.ask([Command.SAVE])
        self._future.release()
