"""One attempt with wrong input: its exit code and message, and bytes with something wrong."""

import signal

from cli.failures import explained

SECONDS = 20
"""For one attempt, on a busy machine."""


class TooLate(BaseException):
    """Not an Exception: no reader may take it for damage."""


def outcome(action):
    """Exit code and message of an attempt; 0 where it was accepted."""

    def stop(*_):
        raise TooLate

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    try:
        action()
    except Exception as error:
        message, code = explained(error)
        return code, message
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    return 0, ""


def check(action, what):
    code, message = outcome(action)
    assert code in (0, 2, 3, 4, 5, 6), f"{what!r:.300}: {message}"
    if code:
        assert message and "\n" not in message.strip() and len(message) < 1200, f"{what!r:.300}: {message!r:.2000}"


def damaged(content, rng):
    """Bytes with something wrong: flipped, cut, repeated, overwritten or foreign."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 8))):
        kind, at = rng.randrange(6), rng.randrange(max(1, len(data)))
        if not data:
            break
        if kind == 0:
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del data[at:]
        elif kind == 2:
            data[at:at] = data[at : at + rng.randrange(64)]
        elif kind == 3:
            data[at : at + 4] = rng.choice((b"\xff" * 4, b"\0" * 4, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f"))
        elif kind == 4:
            del data[at : at + rng.randrange(1, 64)]
        else:
            # Headers are where sizes stand.
            data[min(at, rng.randrange(128)) % len(data)] = rng.randrange(256)
    return bytes(data)
