"""Signals are taken where that leaves nothing half done."""

from __future__ import annotations

import ctypes
import os
import signal
import threading

import pytest

from deploy.util.signals import Interrupted, Interruption

SIGNALS = [signal.SIGINT, signal.SIGTERM]


def _send(number: signal.Signals) -> None:
    os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_is_noted_and_raised_at_the_next_check(number: signal.Signals) -> None:
    interruption = Interruption()
    with interruption.handling():
        interruption.raise_if_requested()
        _send(number)
        assert interruption.requested
        with pytest.raises(Interrupted):
            interruption.raise_if_requested()


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_raises_at_once_where_that_is_allowed(number: signal.Signals) -> None:
    interruption = Interruption()
    with interruption.handling():
        with pytest.raises(Interrupted), interruption.interruptible():
            _send(number)
        _send(number)  # a second one disturbs nobody


def test_no_signal_no_interruption() -> None:
    interruption = Interruption()
    with interruption.handling(), interruption.interruptible():
        interruption.raise_if_requested()
    assert not interruption.requested


def test_a_signal_raises_at_once_while_the_run_waits() -> None:
    interruption = Interruption()
    interruption.is_idle = lambda: True
    with interruption.handling(), pytest.raises(Interrupted):
        _send(signal.SIGINT)


def test_an_earlier_signal_raises_on_entry() -> None:
    interruption = Interruption()
    with interruption.handling():
        _send(signal.SIGINT)
        with pytest.raises(Interrupted), interruption.interruptible():
            pytest.fail("must not be entered")


def test_an_interruption_that_a_c_library_drops_is_not_lost_and_says_nothing(
    capfd: pytest.CaptureFixture[str],
) -> None:
    callback = ctypes.CFUNCTYPE(None)(lambda: _send(signal.SIGINT))
    interruption = Interruption()
    with interruption.handling():
        with interruption.interruptible():
            callback()
            with pytest.raises(Interrupted):
                _send(signal.SIGINT)  # an impatient one is heeded, as the first had no effect
        with pytest.raises(Interrupted):
            interruption.raise_if_requested()
    assert capfd.readouterr().err == ""


def test_an_interruption_of_which_a_c_library_makes_an_error_of_its_own_is_one() -> None:
    def convert() -> None:
        try:
            _send(signal.SIGINT)
        except Interrupted:
            raise ValueError("Invalid affine transformation matrix") from None

    interruption = Interruption()
    with interruption.handling(), pytest.raises(Interrupted), interruption.interruptible():
        convert()


def test_an_error_without_a_signal_stays_one() -> None:
    interruption = Interruption()
    with interruption.handling(), pytest.raises(ValueError, match="really"), interruption.interruptible():
        raise ValueError("really")


def test_who_ignores_signals_for_good_in_another_s_watch_has_the_last_word() -> None:
    before = [signal.getsignal(number) for number in SIGNALS]
    inner = Interruption()
    try:
        with Interruption().handling(), inner.handling(last=True):
            _send(signal.SIGINT)
        assert [signal.getsignal(number) for number in SIGNALS] == [signal.SIG_IGN] * 2
    finally:
        for number, handler in zip(SIGNALS, before, strict=True):
            signal.signal(number, handler)


def test_an_interruption_is_no_exception_that_others_catch() -> None:
    assert not issubclass(Interrupted, Exception)


def test_handlers_are_put_back() -> None:
    before = [signal.getsignal(number) for number in SIGNALS]
    with Interruption().handling():
        assert [signal.getsignal(number) for number in SIGNALS] != before
    assert [signal.getsignal(number) for number in SIGNALS] == before


def test_after_the_last_interruption_further_signals_are_ignored() -> None:
    before = [signal.getsignal(number) for number in SIGNALS]
    interruption = Interruption()
    try:
        with interruption.handling(last=True):
            _send(signal.SIGINT)
        for number in SIGNALS:
            _send(number)  # neither raises nor ends this process
    finally:
        for number, handler in zip(SIGNALS, before, strict=True):
            signal.signal(number, handler)


def test_other_threads_leave_signals_alone() -> None:
    seen: list[bool] = []

    def observe() -> None:
        before = signal.getsignal(signal.SIGINT)
        with Interruption().handling():
            seen.append(signal.getsignal(signal.SIGINT) is before)

    thread = threading.Thread(target=observe)
    thread.start()
    thread.join()
    assert seen == [True]
