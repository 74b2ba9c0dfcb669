"""What all tests share."""

import signal


def pytest_configure() -> None:
    """Let tests interrupt: what runs in the background inherits an ignored Ctrl-C."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
