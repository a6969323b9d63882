"""What a connection to the broker needs, read again for each connection, and what its errors mean."""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
import sys
from pathlib import Path
from typing import Any

import aiomqtt
from paho.mqtt.reasoncodes import ReasonCode

from firmware_link.reconnect import Problem
from flying_vines.config.address import BrokerAddress, parse_broker
from flying_vines.config.config import MqttConfig
from flying_vines.files.bounded import decoded, first_line, read_private

THROWN_OUT = Problem(
    "it accepts us and then closes: does another vehicle have the same mqtt.name?", needs_person=True
)
"""Some brokers do not report that another client has our client id."""
_OTHER_VERSION = 0x84
_NO_GREETING = "Operation timed out"
"""The library's text if a broker accepts the TCP connection but does not answer the MQTT connect message."""
_BY_CODE = {
    0x85: "it does not accept our client id, PREFIX-NAME: set mqtt.prefix and mqtt.name",
    0x86: "it does not accept this user and password: check mqtt.username and mqtt.password_file",
    0x87: "it refuses the login: check mqtt.username and mqtt.password_file, and the broker's list of users",
    0x8A: "it has banned us",
    0x8C: "it requires another authentication method",
    0x8E: "another client has the same client id: does another vehicle have the same mqtt.name?",
}
_NOT_SIGNED = (
    "no authority in {trusted} has signed its certificate: mqtt.ca_file must name the broker's authority"
)
_OTHER_NAME = (
    "its certificate is not for {host}: make one for this name (docs/mqtt.md), or correct mqtt.broker"
)
_NOT_TRUSTED = {
    9: "its certificate is not valid yet: is this computer's clock right?",
    10: "its certificate has expired: make a new one (docs/mqtt.md); or is this computer's clock wrong?",
    18: _NOT_SIGNED,
    19: _NOT_SIGNED,
    20: _NOT_SIGNED,
    21: _NOT_SIGNED,
    62: _OTHER_NAME,
    64: _OTHER_NAME,
}
"""By OpenSSL's code, X509_V_ERR_… in x509_vfy.h."""
_BADLY_MADE = "Python {python} refuses its certificate, or {trusted}: {why}. Make both again (docs/mqtt.md)"
"""All other codes. Python 3.13 and newer ask for what RFC 5280 demands, older ones do not."""


_SILENT = logging.Logger(__name__, logging.CRITICAL + 1)


class RefusedError(Exception):
    """The broker accepted the login, but refuses our messages or ends the connection."""


class FileError(Exception):
    """A password, key or certificate cannot be used."""


async def login(mqtt: MqttConfig, version: aiomqtt.ProtocolVersion, timeout_s: float) -> dict[str, Any]:
    """Arguments of the library's client. Raises `FileError`."""
    broker = parse_broker(mqtt.broker)
    secret, tls_context = await asyncio.to_thread(lambda: (password(mqtt), tls(mqtt, broker)))
    return {
        "hostname": broker.host,
        "port": broker.port,
        "username": mqtt.username or None,
        "password": secret,
        "protocol": version,
        "timeout": timeout_s,
        "tls_context": tls_context,
        "logger": _SILENT,
    }


def password(mqtt: MqttConfig) -> str | None:
    """The first line of the file that is no comment. Raises `FileError`; may block on a slow disk."""
    if not mqtt.password_file:
        return None
    path, what = Path(mqtt.password_file), "the password"
    try:
        text = decoded(read_private(path, what, FileError))
    except UnicodeDecodeError:
        raise FileError(f"{path}: {what} cannot be read: not UTF-8") from None
    # A password may itself begin with "#".
    found = first_line(text) or text.strip().partition("\n")[0].strip()
    if not found:
        raise FileError(f"{mqtt.password_file}: no password in its first line")
    return found


def tls(mqtt: MqttConfig, broker: BrokerAddress) -> ssl.SSLContext | None:
    """The TLS context, or None without TLS. Raises `FileError`; may block on a slow disk."""
    if not broker.tls:
        return None
    try:
        context = ssl.create_default_context(cafile=mqtt.ca_file or None)
    except OSError as error:
        raise FileError(f"{mqtt.ca_file}: {_why(error, 'it contains no certificates')}") from None
    if mqtt.certificate_file:
        read_private(Path(mqtt.key_file), "the key", FileError)
        try:
            # Without a password here, OpenSSL asks for a key's password on the terminal and waits.
            context.load_cert_chain(mqtt.certificate_file, mqtt.key_file, password="")
        except OSError as error:
            why = _why(error, "they are not a certificate and its key, or the key has a password")
            raise FileError(f"{mqtt.certificate_file}, {mqtt.key_file}: {why}") from None
    return context


def _why(error: OSError, of_tls: str) -> str:
    # OpenSSL's texts about a file with wrong content do not help.
    return of_tls if isinstance(error, ssl.SSLError) else str(error.strerror)


def problem_of(error: BaseException, mqtt: MqttConfig, connected: bool) -> Problem:
    """The meaning of `error`. `connected`: the error came after a successful login."""
    broker = parse_broker(mqtt.broker)
    if isinstance(error, RefusedError | FileError):
        return Problem(str(error), needs_person=True)
    cause = _beneath(error)
    if isinstance(cause, aiomqtt.MqttCodeError):
        return _by_code(cause, connected)
    if isinstance(cause, ssl.SSLCertVerificationError):
        text = _NOT_TRUSTED.get(cause.verify_code, _BADLY_MADE).format(
            host=broker.host,
            trusted=mqtt.ca_file or "this computer's list of authorities",
            python=".".join(map(str, sys.version_info[:2])),
            why=cause.verify_message,
        )
        return Problem(text, needs_person=True)
    if broker.tls and not connected and isinstance(cause, ssl.SSLEOFError | ConnectionResetError):
        return Problem("it closes the connection at once: does this port use TLS?", needs_person=True)
    if isinstance(cause, ssl.SSLError):
        reason = (cause.reason or str(cause)).replace("_", " ").lower()
        if reason == "wrong version number":
            return Problem("this port does not use TLS: mqtt:// instead of mqtts://?", needs_person=True)
        return Problem(f"TLS: {reason}", needs_person=True)
    if isinstance(cause, socket.gaierror):
        return Problem("unknown host name: no network, or a wrong address")
    if isinstance(cause, ConnectionRefusedError):
        return Problem("nothing answers there")
    if connected:
        return Problem("the connection is lost")
    if str(error) == _NO_GREETING:
        hint = "refuse mqtt.certificate_file" if broker.tls else "need mqtts://"
        return Problem(f"it accepts the connection but sends nothing: is it a broker, or does it {hint}?")
    if isinstance(cause, TimeoutError):
        return Problem("no answer")
    return Problem(f"{getattr(cause, 'strerror', None) or cause or error}")


def may_want_other_version(error: BaseException) -> bool:
    """True if the broker refused the MQTT version, or did not answer the connect message."""
    if isinstance(error, aiomqtt.MqttCodeError):
        return _code(error) == _OTHER_VERSION
    return str(error) == _NO_GREETING


def _beneath(error: BaseException) -> BaseException | None:
    """The original error, if the library's exception has only a text."""
    if not isinstance(error, aiomqtt.MqttError) or isinstance(error, aiomqtt.MqttCodeError):
        return error
    return error.__cause__ or error.__context__


def _by_code(error: aiomqtt.MqttCodeError, connected: bool) -> Problem:
    text = _BY_CODE.get(_code(error))
    if text is not None:
        return Problem(text, needs_person=True)
    if connected:
        return Problem("the connection is lost")
    reason = error.rc.getName() if isinstance(error.rc, ReasonCode) else str(error)
    return Problem(f"it refuses: {_lower(reason)}")


def _code(error: aiomqtt.MqttCodeError) -> int:
    return error.rc.value if isinstance(error.rc, ReasonCode) else -1


def _lower(sentence: str) -> str:
    return sentence if sentence[1:2].isupper() else sentence[:1].lower() + sentence[1:]
