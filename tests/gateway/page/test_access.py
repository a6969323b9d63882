"""Who may open the page, by the request's headers alone."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from flying_vines.gateway import page_token
from flying_vines.gateway.page.access import Access, Admitted, Refused
from flying_vines.gateway.page_token import PageTokenError

TOKEN = "abcd-efgh-ijkl-mnop"
HERE = {"Host": "127.0.0.1:8017"}
NAME = socket.gethostname().lower()


def local(**headers: str) -> Admitted | Refused:
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    return Access("127.0.0.1", 8017, "").check({**HERE, **given})


def beyond(token: str = "", **headers: str) -> Admitted | Refused:
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    return Access("0.0.0.0", 8017, TOKEN).check({"Host": "192.168.4.1:8017", **given}, token)


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8017", "localhost:8017", "LOCALHOST:9000", "[::1]:8017", "127.1.2.3"]
)
def test_this_machine_may_look_and_ask(host: str) -> None:
    assert local(Host=host) == Admitted(may_ask=True)
    assert local(Host=host, Origin=f"http://{host.lower()}") == Admitted(may_ask=True)


@pytest.mark.parametrize(
    "host",
    [
        "",
        "evil.example",
        "evil.example:8017",
        "192.168.4.1:8017",
        "localhost.evil.example",
        "me@127.0.0.1",
        "127.0.0.1:8017; script-src *",
        "[::1",
        "a b",
        "[x]",
    ],
)
def test_a_name_that_was_pointed_here_by_others_is_turned_away(host: str) -> None:
    found = local(Host=host, Origin=f"http://{host}")
    assert isinstance(found, Refused)
    assert found.status == 421


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "",
        "http://127.0.0.1:9000",
        "http://localhost:8017",
        "file://",
        "http://[",
        "127.0.0.1:8017",
    ],
)
def test_another_sites_page_is_turned_away(origin: str) -> None:
    found = local(Origin=origin)
    assert isinstance(found, Refused)
    assert found.status == 403


def test_another_sites_link_may_be_followed_but_not_loaded_from() -> None:
    assert isinstance(local(Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="no-cors"), Refused)
    assert isinstance(local(Sec_Fetch_Site="same-site", Sec_Fetch_Mode="websocket"), Refused)
    assert local(Sec_Fetch_Site="cross-site", Sec_Fetch_Mode="navigate") == Admitted(may_ask=True)
    assert local(Sec_Fetch_Site="same-origin", Sec_Fetch_Mode="cors") == Admitted(may_ask=True)


def test_from_the_network_only_with_the_token() -> None:
    for found in (beyond(), beyond("abcd-efgh-ijkl-mnoq"), beyond("x" * 10_000), beyond("абвг" * 4)):
        assert isinstance(found, Refused)
        assert found.status == 401
    assert beyond(TOKEN) == Admitted(may_ask=True, token=TOKEN)
    assert beyond(" ABCDEFGH ijklmnop ") == Admitted(may_ask=True, token=TOKEN)
    assert beyond(Authorization=f"Bearer {TOKEN}") == Admitted(may_ask=True, token=TOKEN)
    access = Access("0.0.0.0", 8017, TOKEN)
    here = {"Host": "192.168.4.1:8017"}
    assert access.check(here, cookies={"flying-vines-8017": TOKEN}) == Admitted(may_ask=True, token=TOKEN)
    assert isinstance(access.check(here, cookies={"flying-vines-8018": TOKEN}), Refused)


def test_a_viewer_may_not_send_requests() -> None:
    watching = page_token.watching(TOKEN)
    assert watching != TOKEN
    assert beyond(watching) == Admitted(may_ask=False, token=watching)
    assert beyond(Authorization=f"bearer {watching}").may_ask is False  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "host", ["192.168.4.1:8017", f"{NAME}:8017", f"{NAME}.local", "[fe80::1]:8017", "localhost"]
)
def test_on_the_network_it_has_addresses_and_its_own_name(host: str) -> None:
    assert isinstance(beyond(TOKEN, Host=host), Admitted)


def test_on_the_network_no_other_name_even_with_the_token() -> None:
    found = beyond(TOKEN, Host="evil.example:8017")
    assert isinstance(found, Refused)
    assert found.status == 421


def test_no_page_for_the_network_without_a_token() -> None:
    with pytest.raises(ValueError, match="token"):
        Access("0.0.0.0", 8017, "")


def test_a_token_is_made_once_for_its_owner_alone(tmp_path: Path) -> None:
    file = tmp_path / "state" / "vine.page-token"
    token = page_token.read_or_make(file)
    assert file.stat().st_mode & 0o777 == 0o600
    assert len(token.replace("-", "")) == 16
    assert page_token.read_or_make(file) == token
    assert file.read_text().splitlines() == [token, f"{page_token.watching(token)} only watches"]
    assert page_token.read_or_make(tmp_path / "other") != token


@pytest.mark.parametrize(
    "text, mode, said",
    [
        ("short", 0o600, "no valid page token"),
        ("", 0o600, "no valid page token"),
        (TOKEN, 0o640, "chmod 600"),
        ("ä" * 20, 0o600, "no valid page token"),
    ],
)
def test_a_file_that_is_no_token_is_refused_with_this_reason(
    tmp_path: Path, text: str, mode: int, said: str
) -> None:
    file = tmp_path / "token"
    file.write_text(text)
    file.chmod(mode)
    with pytest.raises(PageTokenError, match=said) as error:
        page_token.read_or_make(file)
    assert str(file) in str(error.value)


def test_a_folder_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(PageTokenError, match="cannot be written"):
        page_token.read_or_make(tmp_path / "file" / "token")
