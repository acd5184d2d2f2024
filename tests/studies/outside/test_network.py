"""What the robots of the network study are told; the networks themselves are tests/network/test_relay.py's."""

import json

from router_config import session, settings
from tests.network.conftest import make_fleet  # noqa: F401
from tests.studies.outside import network


def test_a_patient_robot_has_the_lease_that_its_case_says_and_no_other_setting(monkeypatch, make_fleet) -> None:  # noqa: F811
    for module, name in ((settings, "_over"), (session, "DIAL_LOOKS")):
        monkeypatch.setattr(module, name, getattr(module, name))  # puts them back
    fleet = make_fleet({"r1": ("r2",), "r2": ("r1",)})
    shipped = json.loads(settings.peer_config(fleet, "r2"))
    network.patient(20.0)
    patient = json.loads(settings.peer_config(fleet, "r2"))
    assert shipped["transport"]["link"]["tx"].pop("lease") == 1e3 * network.LEASE_S
    assert patient["transport"]["link"]["tx"].pop("lease") == 20_000
    assert patient == shipped
    assert session.DIAL_LOOKS * session.LOOK_S == 20.0
