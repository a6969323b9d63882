"""The table [mqtt]: every mistake is found before a flight and names the key and what to do."""

from __future__ import annotations

import pytest

from flying_vines.config import config
from flying_vines.config.address import BrokerAddress, parse_broker

TLS = 'broker = "mqtts://b"\n'


def parsed(text: str) -> config.MqttConfig:
    return config.parse(f"[mqtt]\n{text}\n[switch]\npositions = ['', '']\n[profiles]\n", "my.toml").mqtt


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("mqtt://b", BrokerAddress("b", 1883, False)),
        ("mqtts://b", BrokerAddress("b", 8883, True)),
        ("mqtt://10.0.0.2:1884", BrokerAddress("10.0.0.2", 1884, False)),
        ("mqtts://[fd00::1]:8884", BrokerAddress("fd00::1", 8884, True)),
        ("mqtt://broker.example", BrokerAddress("broker.example", 1883, False)),
    ],
)
def test_every_form_of_an_address(text: str, address: BrokerAddress) -> None:
    assert parse_broker(text) == address
    assert parsed(f'broker = "{text}"').broker == text


@pytest.mark.parametrize(
    "text",
    [
        "b",
        "b:1883",
        "http://b",
        "mqtt:b",
        "mqtt://",
        "mqtt://:1883",
        "mqtt://b:0",
        "mqtt://b:65536",
        "mqtt://b:x",
        "mqtt://b/path",
        "mqtt://b?x=1",
        "mqtt://[fd00::1",
        "",
    ],
)
def test_everything_else_is_none(text: str) -> None:
    with pytest.raises(ValueError, match="is not a broker: give mqtt://HOST"):
        parse_broker(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('broker = "b:1883"', "my.toml:2: mqtt.broker: 'b:1883' is not a broker"),
        ('broker = "mqtt://me:secret@b"', "mqtt.broker: remove user and password from the address"),
        ('prefix = "a/#"', "mqtt.prefix: 'a/#' is not a valid topic name"),
        ('prefix = "/a"', "mqtt.prefix: '/a' is not a valid topic name"),
        ('prefix = ""', "mqtt.prefix: is empty"),
        ('name = "+"', "mqtt.name: '+' is not a valid topic name"),
        ('name = "a/b"', "mqtt.name: 'a/b' is not a valid topic name"),
        ('name = "Köln"', "mqtt.name: 'Köln' is not a valid topic name"),
        ('discovery_prefix = "home assistant"', "mqtt.discovery_prefix"),
        ('commands = ["explode"]', "mqtt.commands[0]"),
        ('commands = "vent"', "mqtt.commands"),
        ("rate_Hz = 100", "mqtt.rate_Hz"),
        ('password_file = "/etc/p"', "mqtt.password_file: needs a username"),
        ('username = "u"\npassword_file = "p"', "my.toml:3: mqtt.password_file: 'p': give an absolute path"),
        ('broker = "mqtt://b"\nca_file = "/etc/ca.pem"', "mqtt.ca_file: needs TLS"),
        (TLS + 'certificate_file = "/c"', "mqtt.certificate_file: set both certificate_file and key_file"),
        (TLS + 'key_file = "/k"', "mqtt.key_file: set both certificate_file and key_file"),
    ],
)
def test_every_mistake_is_reported_with_its_place_and_reason(text: str, said: str) -> None:
    with pytest.raises(config.ConfigError) as caught:
        parsed(text)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_nothing_is_told_and_nothing_may_be_asked_for_unless_the_configuration_says_so() -> None:
    assert parsed("").broker == ""
    assert parsed("").commands == ()
    assert parsed("").discovery_prefix == ""
    assert parsed('commands = ["vent", "bend"]').commands == ("vent", "bend")
