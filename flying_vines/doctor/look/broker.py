"""Tries a connection to the MQTT broker, with the service's own credentials and error texts."""

from __future__ import annotations

import asyncio
import logging
import ssl
import time

from flying_vines.config.address import parse_broker
from flying_vines.config.config import MqttConfig
from flying_vines.doctor.checks.network import BrokerFacts

TIMEOUT_S = 5.0

_SILENT = logging.Logger(__name__, logging.CRITICAL + 1)


async def facts(mqtt: MqttConfig) -> BrokerFacts:
    """Connects and disconnects. A new client id is used, so that a running service stays connected."""
    if not mqtt.broker:
        return BrokerFacts("")
    try:
        import aiomqtt

        from flying_vines.gateway.mqtt import credentials
        from flying_vines.gateway.mqtt.problems import FileError, may_want_other_version, problem_of
    except ModuleNotFoundError as error:
        return BrokerFacts(mqtt.broker, f"{error.name} is missing", missing_package=True)
    broker = parse_broker(mqtt.broker)

    def read() -> tuple[str | None, ssl.SSLContext | None]:
        return credentials.password(mqtt), credentials.tls(mqtt, broker)

    async def greet(version: aiomqtt.ProtocolVersion) -> None:
        password, tls = await asyncio.to_thread(read)
        client = aiomqtt.Client(
            broker.host,
            broker.port,
            username=mqtt.username or None,
            password=password,
            protocol=version,
            timeout=TIMEOUT_S,
            tls_context=tls,
            logger=_SILENT,
        )
        async with client:
            pass

    began_s = time.monotonic()
    try:
        try:
            await greet(aiomqtt.ProtocolVersion.V5)
        except aiomqtt.MqttError as error:
            if not may_want_other_version(error):
                raise
            await greet(aiomqtt.ProtocolVersion.V311)
    except (aiomqtt.MqttError, FileError, OSError) as error:
        problem = problem_of(error, mqtt, connected=False)
        return BrokerFacts(mqtt.broker, problem.text, needs_person=problem.needs_person)
    return BrokerFacts(mqtt.broker, took_s=time.monotonic() - began_s)
