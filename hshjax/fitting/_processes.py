"""Processes that share a call: the first puts together what each has found, and a lost one is named in bounded time.

Everything goes through the key-value store of jax's coordination service, which `jax.distributed.initialize` starts in
process 0, unless a `coordinator` has it: unlike a collective, it tells who is missing. A thread of every process writes
a beat there; the first process watches the beats of all, all watch that of the first, and what one has to say of a lost
one ends the others too.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from threading import Event, Thread
from typing import Any

import jax
from jax.sharding import Mesh

PIECE = 2**20
"""Bytes of a message to the service."""

BEATS = 8
"""In the time after which a process counts as lost."""

PAUSE = 0.05
"""Between two looks at the service [s]."""

FAREWELL = 1.0
"""For the others to print why they end, before the service ends with its process [s]."""

_calls: Counter = Counter()
"""How often which processes have shared a call of which name: every call has keys of its own."""


class ProcessError(RuntimeError):
    """A process that shared the call is lost, or has ended with an error."""


class Processes:
    """The processes of a mesh for the time of one call, which all of them make; without a mesh, this one alone.

    `index` of `count`: the place of this one. `timeout`: seconds without a sign of life after which one counts as lost.
    `advice`: what to do then, the end of the sentence.
    """

    def __init__(self, mesh: Mesh | None, name: str, timeout: float, advice: str):
        own = jax.process_index()
        self.ids = [own] if mesh is None else sorted({device.process_index for device in mesh.devices.flat})
        self.index, self.count = self.ids.index(own), len(self.ids)
        self._timeout, self._advice = timeout, advice
        self._ended, self._lost, self._failure, self._step = Event(), "", None, 0
        if not timeout > 0:
            raise ValueError(f"timeout must be > 0 seconds, got {timeout}")
        if self.count > 1:
            key = name, *self.ids
            self._prefix = f"hshjax/{name}/{'-'.join(map(str, self.ids))}/{_calls[key]}"
            _calls[key] += 1
            self._client = _client()
            self._heard = [(time.monotonic(), "")] * self.count
            self._thread = Thread(target=self._live, daemon=True)

    def __enter__(self) -> "Processes":
        if self.count > 1:
            self._thread.start()
        return self

    def __exit__(self, kind, error, trace) -> None:
        if self.count == 1:
            return
        if error is not None:
            if not isinstance(error, ProcessError):
                self._say(f"process {self.ids[self.index]} has ended with an error ({kind.__name__}: {error})")
            self._set(f"told/{self.index}", "yes")
            if self.index == 0:  # the service ends with this process
                self._wait_for_others()
        self._ended.set()
        self._thread.join()

    def check(self) -> None:
        """ProcessError where a process is lost or has ended with an error."""
        if self._failure is not None:
            raise ProcessError(f"the coordination service of jax does not answer; {self._advice}") from self._failure
        if self._lost:
            raise ProcessError(f"{self._lost}; {self._advice}")

    def put_together(self, own: bytes, merge: Callable[[list[bytes]], bytes]) -> bytes:
        """`merge` of what every process has, in their order, which the first does; the same bytes everywhere."""
        if self.count == 1:
            return merge([own])
        self._step += 1
        place = f"found/{self._step}"
        self._send(f"{place}/{self.index}", own)
        if self.index == 0:
            found = [self._receive(f"{place}/{k}") for k in range(self.count)]
            self._send(f"{place}/merged", merge(found))
        return self._receive(f"{place}/merged")

    def finish(self) -> None:
        """Waits until every process is here."""
        if self.count == 1:
            return
        self._set(f"here/{self.index}", "yes")
        if self.index == 0:
            self._wait(lambda: len(self._all("here")) == self.count)
            self._client.key_value_delete(f"{self._prefix}/found/")
            self._set("over/0", "yes")
        self._wait(lambda: bool(self._all("over")))
        self._set(f"gone/{self.index}", "yes")

    def _send(self, name: str, message: bytes) -> None:
        pieces = [message[k : k + PIECE] for k in range(0, len(message), PIECE)]
        for k, piece in enumerate(pieces):
            self._client.key_value_set_bytes(f"{self._prefix}/{name}/{k}", piece)
        self._set(f"ready/{name}/0", str(len(pieces)))

    def _receive(self, name: str) -> bytes:
        self._wait(lambda: bool(self._all(f"ready/{name}")))
        (pieces,) = self._all(f"ready/{name}").values()
        limit = int(1000 * self._timeout)
        names = [f"{self._prefix}/{name}/{k}" for k in range(int(pieces))]
        return b"".join(self._client.blocking_key_value_get_bytes(one, limit) for one in names)

    def _wait(self, done: Callable[[], bool]) -> None:
        while not done():
            self.check()
            time.sleep(PAUSE)

    def _set(self, name: str, value: str) -> None:
        self._client.key_value_set(f"{self._prefix}/{name}", value, allow_overwrite=True)

    def _all(self, name: str) -> dict[str, str]:
        """What has been set below a name: values by the last part of their keys."""
        return {
            key.rsplit("/", 1)[1]: value for key, value in self._client.key_value_dir_get(f"{self._prefix}/{name}/")
        }

    def _say(self, sentence: str) -> None:
        self._lost = self._lost or sentence
        self._set(f"lost/{self.index}", sentence)

    def _live(self) -> None:
        """What the thread does: gives a sign of life, and looks for those of others."""
        beats = 0
        try:
            while not self._ended.is_set():
                beats += 1
                self._set(f"{_place(self.index)}/{self.index}", str(beats))
                said = self._all("lost")
                if said and not self._lost:
                    self._lost = next(iter(said.values()))
                if not self._lost:
                    self._watch()
                self._ended.wait(self._timeout / BEATS)
        except Exception as error:
            self._failure = error  # `check` raises it

    def _watch(self) -> None:
        """The first process listens to the others, and they to the first: n questions at a time, not n²."""
        others = range(1, self.count) if self.index == 0 else [0]
        now, beats = time.monotonic(), self._all(_place(others[0]))
        for k in others:
            beat = beats.get(str(k), "")
            if beat != self._heard[k][1]:
                self._heard[k] = now, beat
            if now - self._heard[k][0] > self._timeout and str(k) not in self._all("gone"):
                self._say(f"process {self.ids[k]} has not reported for {self._timeout:g} s")
                return

    def _wait_for_others(self) -> None:
        """Until all that live know why the call ends; not longer than it takes to notice that one does not live."""
        end = time.monotonic() + self._timeout
        while time.monotonic() < end:
            told, now = self._all("told"), time.monotonic()
            living = [k for k, (heard, _) in enumerate(self._heard) if k == 0 or now - heard < self._timeout]
            if all(str(k) in told for k in living):
                time.sleep(FAREWELL)
                return
            time.sleep(PAUSE)


def _place(index: int) -> str:
    """Where a process writes its beats."""
    return "first" if index == 0 else "beat"


def check_same_call(calls: Sequence[Any]) -> None:
    """ValueError, naming the first process that differs, unless all of a mesh say the same of their call."""
    for k, call in enumerate(calls):
        if call != calls[0]:
            raise ValueError(f"process {k} of the mesh makes another call, {call}, than the first, {calls[0]}")


def _client() -> Any:
    """Of the coordination service. jax has no public name for it; other libraries take it from the same place."""
    from jax._src import distributed

    if distributed.global_state.client is None:
        raise ValueError("a mesh of several processes needs jax.distributed.initialize in each, before anything else")
    return distributed.global_state.client
