"""Password and certificates for the broker, read again for each connection."""

from __future__ import annotations

import ssl
from pathlib import Path

from flying_vines.config.address import BrokerAddress
from flying_vines.config.config import MqttConfig
from flying_vines.files.bounded import decoded, first_line, read_private
from flying_vines.gateway.mqtt.problems import FileError


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
