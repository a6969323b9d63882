"""What a failed connection means, in a sentence for people."""

from __future__ import annotations

import socket
import ssl

import aiomqtt
from paho.mqtt.reasoncodes import ReasonCode

from flying_vines.config.address import BrokerAddress
from flying_vines.gateway.mqtt.health import BrokerProblem

_OTHER_VERSION = 0x84
_NO_GREETING = "Operation timed out"
"""The library's words; a port that does not answer has others."""
_BY_CODE = {
    0x85: "it does not accept our client id: set mqtt.client_id",
    0x86: "it does not know this user and password: see mqtt.username and mqtt.password_file",
    0x87: "it does not let us in: see mqtt.username and mqtt.password_file, and the broker's list of users",
    0x8A: "it has banned us",
    0x8C: "it wants another way of authentication",
    0x8E: "another client came with the same client id: has another vehicle the same mqtt.name?",
}


class RefusedError(Exception):
    """The broker let us in, and then not do what we are here for."""


class FileError(Exception):
    """A password, key or certificate cannot be used."""


def problem_of(error: BaseException, broker: BrokerAddress, connected: bool) -> BrokerProblem:
    """What `error` means; `connected`: it came after the broker had let us in."""
    if isinstance(error, RefusedError | FileError):
        return BrokerProblem(str(error), needs_person=True)
    cause = _beneath(error)
    if isinstance(cause, aiomqtt.MqttCodeError):
        return _by_code(cause, connected)
    if isinstance(cause, ssl.SSLCertVerificationError):
        return BrokerProblem(
            f"its certificate is not trusted: {_lower(cause.verify_message)}", needs_person=True
        )
    if broker.tls and not connected and isinstance(cause, ssl.SSLEOFError | ConnectionResetError):
        return BrokerProblem("it closes at once: does it speak TLS at this port?", needs_person=True)
    if isinstance(cause, ssl.SSLError):
        reason = (cause.reason or str(cause)).replace("_", " ").lower()
        if reason == "wrong version number":
            return BrokerProblem(
                "it speaks no TLS at this port: mqtt:// instead of mqtts://?", needs_person=True
            )
        return BrokerProblem(f"TLS: {reason}", needs_person=True)
    if isinstance(cause, socket.gaierror):
        return BrokerProblem("there is no such name: no network, or a wrong address")
    if isinstance(cause, ConnectionRefusedError):
        return BrokerProblem("nothing answers there")
    if connected:
        return BrokerProblem("the connection is lost")
    if str(error) == _NO_GREETING:
        hint = "?" if broker.tls else ", or does it want mqtts://?"
        return BrokerProblem(f"something is there and says nothing: is it a broker{hint}")
    if isinstance(cause, TimeoutError):
        return BrokerProblem("no answer")
    return BrokerProblem(f"{getattr(cause, 'strerror', None) or cause or error}")


def may_want_other_version(error: BaseException) -> bool:
    """Whether the broker said so, or nothing at all when it was greeted."""
    if isinstance(error, aiomqtt.MqttCodeError):
        return _code(error) == _OTHER_VERSION
    return str(error) == _NO_GREETING


def _beneath(error: BaseException) -> BaseException | None:
    """What the library found, where it hands on no more than a text about it."""
    if not isinstance(error, aiomqtt.MqttError) or isinstance(error, aiomqtt.MqttCodeError):
        return error
    return error.__cause__ or error.__context__


def _by_code(error: aiomqtt.MqttCodeError, connected: bool) -> BrokerProblem:
    text = _BY_CODE.get(_code(error))
    if text is not None:
        return BrokerProblem(text, needs_person=True)
    if connected:
        return BrokerProblem("the connection is lost")
    said = error.rc.getName() if isinstance(error.rc, ReasonCode) else str(error)
    return BrokerProblem(f"it refuses: {_lower(said)}")


def _code(error: aiomqtt.MqttCodeError) -> int:
    return error.rc.value if isinstance(error.rc, ReasonCode) else -1


def _lower(sentence: str) -> str:
    return sentence if sentence[1:2].isupper() else sentence[:1].lower() + sentence[1:]
