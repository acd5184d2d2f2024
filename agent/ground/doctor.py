"""`aucamp doctor`: a running fleet looked at from outside, from the ports inwards. What a port shows to be wrong is not
asked any further."""

from __future__ import annotations

import contextlib
import errno
import socket
import ssl
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

from msgspec import UNSET

from agent.clock import machine
from agent.core.config import ConfigError, Fleet
from agent.core.messages import NeighbourState
from agent.core.robot_view import RobotView, robot_view
from agent.ground.check import OPEN, computer_findings, running_findings
from agent.ground.check_files import SOON_DAYS, Finding, certificate_findings, is_here, loopback_findings
from agent.ground.console import NEAR_V, SURFACES_V
from agent.ground.doctor_facts import LISTEN_S, Facts, Looker, Offset, Shown, best, clock_finding, listen
from agent.process.certificates import AUTHORITY, certificate_file, check_pair, key_file, parties
from agent.process.keys import keys_folder
from agent.process.launch import addresses_of
from agent.process.transport import LOOKER, fleet_clock
from agent.robot.fleet_reader import load_fleet
from agent.robot.operator import why_closed
from router_config.settings import metadata, observer_config

# --- judgement ---
# What a look at a running fleet means: one line for each thing that is not as it should be. Pure.

Said = Mapping[str, str]  # by what robots of this fleet file would call themselves: metadata

SAME = "give all the same file, and start again those that had another"


def robot_findings(fleet: Fleet, facts: Facts, robots: Collection[str], expected: Mapping[str, Said]) -> list[Finding]:
    """About each robot that could be dialled. `expected`: what it would say of itself by our file and version."""
    return [finding for name in robots for finding in _robot(fleet, facts, name, expected[name])]


def _robot(fleet: Fleet, facts: Facts, name: str, expected: Said) -> Iterator[Finding]:
    link, state = facts.links.get(name), facts.states.get(name)
    if link is None and state is None:
        text = f"its port answers, but no link came about in {LISTEN_S:.0f} s: its agent hangs, or it is no agent"
        yield Finding("wrong", name, f"{text}; start it again, and look what listens there: ss -ltnp")
        return
    shown = facts.shown.get(link.session) if link is not None else None
    reasons = [
        *(_who(fleet, facts, name, link.session) if link is not None else ()),
        *(_differences(name, shown, expected) if shown is not None else ()),
    ]
    yield from reasons
    if state is None:
        if not any(reason.level == "wrong" for reason in reasons):  # else that is to be mended first
            yield _mute(fleet, facts, name, shown)
        return
    if lost := facts.lost.get(name):
        times = "" if lost == 1 else f" {lost} times"
        text = f"its link to us went{times} while we looked"
        yield Finding("warning", name, f"{text}: a bad cable or radio, or two agents of one name; look there")
    if state.mode != "running":
        yield Finding("warning", name, f"says that it is {state.mode}; its log says why")
    if state.battery_v is not UNSET and state.battery_v < NEAR_V:
        text = f"its battery is at {state.battery_v:.1f} V, and at {SURFACES_V:.1f} V its module surfaces; charge it"
        yield Finding("warning", name, text)
    yield from (Finding("warning", name, f"says of itself: {fault}") for fault in state.faults)


def _who(fleet: Fleet, facts: Facts, name: str, session: str) -> Iterator[Finding]:
    """Whether who listens where a robot should is that robot, and alone."""
    for agent in sorted(facts.agents):
        if agent.session != session:
            continue
        listen = fleet.robot[name].listen
        if agent.fleet != fleet.fleet:
            text = f"{agent.robot} of fleet '{agent.fleet}' listens at {listen}; write one name in both fleet files"
            yield Finding("wrong", name, text)
        elif agent.robot != name:
            text = f"{agent.robot} listens at {listen}; give each robot the address of its own computer, in all files"
            yield Finding("wrong", name, text)
    ours = [agent for agent in facts.agents if (agent.fleet, agent.robot) == (fleet.fleet, name)]
    if len(ours) > 1:
        yield Finding("wrong", name, f"{len(ours)} agents are called so; end all but one")


def _differences(name: str, shown: Shown, expected: Said) -> Iterator[Finding]:
    """What the robot goes by and we do not."""
    said = shown.metadata
    if "file" in said and said["file"] != expected["file"]:
        text = f"has another fleet file (its digest is {said['file']}, ours {expected['file']}): tank, targets, robots"
        yield Finding("wrong", name, f"{text} or estimation differ; {SAME}")
    if "rules" in said and said["rules"] != expected["rules"]:
        text = f"has other access rules (their digest is {said['rules']}, by our file {expected['rules']}): [access],"
        yield Finding("wrong", name, f"{text} neighbours or targets differ; {SAME}")
    if {"pose"} <= said.keys() & expected.keys() and said["pose"] != expected["pose"]:
        text = f"hangs at {said['pose']} (x_m, y_m, yaw_deg) by its own fleet file, and at {expected['pose']} by ours"
        yield Finding("warning", name, f"{text}; {SAME}")
    if said.get("version") != expected["version"]:
        theirs = f"version {said['version']}" if "version" in said else "an older version"
        yield Finding("warning", name, f"runs {theirs}, and this is {expected['version']}; install one everywhere")


def _mute(fleet: Fleet, facts: Facts, name: str, shown: Shown | None) -> Finding:
    """Linked, and nothing comes."""
    if name in facts.unreadable:
        text = f"its states cannot be read ({facts.unreadable[name]}); use one version of aucamp everywhere"
        return Finding("wrong", name, text)
    nothing = f"is linked, but showed nothing in {LISTEN_S:.0f} s"
    announced = any(agent.session == facts.links[name].session for agent in facts.agents)
    if shown is not None or not fleet.secured:
        what = "its loop hangs, or is about to begin" if announced else "it is no agent, or is about to begin"
        return Finding("wrong", name, f"{nothing}: {what}; look again, then start it again")
    text = "its rules do not know us, or its loop hangs; give it this fleet file's [access], and start it again"
    return Finding("wrong", name, f"{nothing}: {text}")


# --- robots that hear each other ---
# Who hears whom: what robots say of their neighbours, and whether those are linked at all. Pure.

QUIET_S = 2.0  # without a word: as long as a link keeps without its other end
FEW = 50  # messages, below which a share of them says nothing
LOSSY = 0.05  # share of messages that did not arrive


def neighbour_findings(fleet: Fleet, facts: Facts, robots: Collection[str]) -> Iterator[Finding]:
    """About each two neighbours of which both were heard by us, for of others something worse has been said."""
    for a in robots:
        for b in fleet.robot[a].neighbours:
            if a < b and b in robots:
                yield from _pair(fleet, facts, a, b)


def _pair(fleet: Fleet, facts: Facts, a: str, b: str) -> Iterator[Finding]:
    deaf = [(one, other) for one, other in ((a, b), (b, a)) if _deaf(fleet, facts, one, other)]
    if deaf:
        one, other = deaf[0]
        who = f"{a} and {b} do not hear each other" if len(deaf) == 2 else f"{one} does not hear {other}"
        yield Finding("wrong", a, f"{who}: {_why(fleet, facts, a, b, one)}")
        return
    for one, other in ((a, b), (b, a)):
        heard = _of(facts, one, other)
        if heard is None or not facts.missed.get((one, other)) or heard.heard < FEW:
            continue  # what was missed once is history
        share = heard.gaps / (heard.heard + heard.gaps)
        if share > LOSSY:
            text = f"misses messages of {other}, {share:.0%} since both run: a thin or bad link, or [link] loss"
            yield Finding("warning", one, f"{text}; look at the network between them")


def _deaf(fleet: Fleet, facts: Facts, one: str, other: str) -> bool:
    heard = _of(facts, one, other)
    longest_s = max(QUIET_S, 3.0 / fleet.link.send_hz)
    return heard is None or heard.age_s is None or heard.age_s > longest_s


def _of(facts: Facts, one: str, other: str) -> NeighbourState | None:
    return next((found for found in facts.states[one].neighbours if found.robot == other), None)


def _why(fleet: Fleet, facts: Facts, a: str, b: str, deaf: str) -> str:
    """Of the two the later name dials the other."""
    said = next((fault for fault in facts.states[deaf].faults if fault.startswith(f"{b if deaf == a else a}: ")), None)
    if said is not None:
        return f"it refuses what it says: {said}"
    if any(_of(facts, one, other) is None for one, other in ((a, b), (b, a))):
        return "one of them does not have the other as a neighbour; give both the same fleet file"
    ends = {name: facts.shown[facts.links[name].session] for name in (a, b) if _is_shown(facts, name)}
    sessions = {facts.links[name].session for name in (a, b) if name in facts.links}
    if not ends:
        return f"they have no link, or other rules; look from {b}'s computer: aucamp doctor FLEET --as {b}"
    if any(end.linked & sessions for end in ends.values()):
        if len(ends) == 2 and all(_goes_by_ours(fleet, name, end) for name, end in ends.items()):
            text = f"their link is mute, and {b} dials {a} again each second and is turned away"
            return f"{text}; start {deaf} again, and install one version of aucamp everywhere"
        return "they are linked, so their rules or fleet files differ; give both the same, and start them again"
    where = fleet.robot[a].listen
    return f"no link: {b} dials {a} at {where}; look from {b}'s computer: aucamp doctor FLEET --as {b}"


def _goes_by_ours(fleet: Fleet, name: str, shown: Shown) -> bool:
    expected = metadata(fleet, name)
    return all(shown.metadata.get(what) == expected[what] for what in ("file", "rules"))


def _is_shown(facts: Facts, name: str) -> bool:
    return name in facts.links and facts.links[name].session in facts.shown


# --- causes of failed dials ---
# What a failed dial means, in words that say what to do: the tables. Pure.
#
# The words on the left are those of Python's socket and ssl modules with OpenSSL 3, as seen with Zenoh 1.10.2.

NO_HOST = "no such host; write the computer's address as a number in listen"
HANGS = (
    "takes the call, but no handshake follows: its agent hangs, or it listens on tcp/, not tls/; start it again, with "
    "this fleet file"
)
NO_TLS = "is no agent of a secured fleet: something else has that port; end it, or give the robot another port"

PORT = {
    errno.ECONNREFUSED: "nobody listens there; start its agent, or compare listen in its fleet file with ours",
    errno.EHOSTUNREACH: "no way to that computer; look whether it is on and its cable in, and compare the address",
    errno.ENETUNREACH: "no way to that network; give this computer an address in it, or correct listen",
}
SILENT = "no answer in a second; look whether its computer is on, a firewall is in between, or listen is wrong"

# Of the robot's certificate, as we see it: a part of what OpenSSL says -> what is wrong with it.
THEIRS = {
    "unable to get local issuer certificate": "its certificate is of another authority than our ca.pem; {copy}",
    "self-signed certificate": "its certificate is of another authority than our ca.pem; {copy}",
    "certificate signature failure": "its certificate is of another authority than our ca.pem; {copy}",
    "certificate has expired": "its certificate has expired by our clock ({now}); {renew}",
    "certificate is not yet valid": "its certificate is not valid yet by our clock ({now}); set that, or {renew}",
    "mismatch": "its certificate is not for {host}, where it listens; {renew}",
    "certificate purpose": "its certificate is not for listening (it lacks serverAuth); {renew}",
}
COPY = "give both computers the files of one and the same authority"
RENEW = "make another: aucamp keys --only"

# Of our certificate, as the robot says: alert of TLS -> what it has against it.
OURS = {
    "CERTIFICATE_REQUIRED": "wants a certificate, and we showed none; copy one here, and name it with --as",
    "UNKNOWN_CA": "does not know the authority of our certificate; {copy}",
    "DECRYPT_ERROR": "our certificate is of another authority, of the same name as its own; {copy}",
    "CERTIFICATE_EXPIRED": "holds our certificate for expired or not valid yet; set its clock, or renew ours",
    "UNSUPPORTED_CERTIFICATE": "our certificate is not for dialling (it lacks clientAuth); {renew}",
}


def port_cause(error: OSError) -> str:
    """Why nobody could be reached at all."""
    if isinstance(error, TimeoutError):
        return SILENT
    return PORT.get(error.errno or 0, f"cannot be dialled: {error.strerror or error}; correct listen")


def theirs(verify_message: str, host: str, now: datetime) -> str:
    """What is wrong with the certificate that was shown to us."""
    for sign, cause in THEIRS.items():
        if sign in verify_message:
            return cause.format(copy=COPY, renew=RENEW, host=host, now=f"{now:%Y-%m-%d %H:%M} UTC")
    return f"its certificate cannot be used ({verify_message}); {RENEW}"


def ours(reason: str, shown: bool) -> str | None:
    """What is wrong with the certificate that we showed; None where it only wants one, and we have none to show."""
    for sign, cause in OURS.items():
        if sign in reason:
            return None if sign == "CERTIFICATE_REQUIRED" and not shown else cause.format(copy=COPY, renew=RENEW)
    return f"turns our certificate down ({reason}); {RENEW}"


# --- one port ---
# Whether somebody answers where a robot should listen, and what is wrong with the certificates, theirs or ours.
#
# Zenoh tells nobody why a handshake failed. Python's own TLS does: the server's faults before the handshake is over,
# ours in what the server says next. A probe does no harm: it looks like a caller that hung up.

CONNECT_S, HANDSHAKE_S, REFUSAL_S = 1.0, 1.3, 0.5  # of the wall, at most, for each part of a probe
PROBE_S = 1.9  # and for all of it


class Probed(NamedTuple):
    """What came of one."""

    cause: str | None = None  # why nothing can come of a link, and what to do; None: it may be dialled
    name: str = ""  # whose certificate it is, by its common name; empty: none was shown
    ends: datetime | None = None  # when that expires


def context(authority: str, pair: tuple[str, str] | None) -> ssl.SSLContext:
    """What a probe trusts, and shows: files of the authority, of a certificate and of its key."""
    made = ssl.create_default_context(cafile=authority)
    if pair is not None:
        made.load_cert_chain(*pair)
    return made


def probe(listen: str, trust: ssl.SSLContext | None, shown: bool = True) -> Probed:
    """Dial tcp/HOST:PORT or tls/HOST:PORT and hang up. `trust`: of a secured fleet; `shown`: it has a certificate to
    show. Takes PROBE_S at most, but for the time in which the host's name is looked up."""
    found, deadline_s = addresses_of(listen), machine.monotonic_s() + PROBE_S
    if not found:
        return Probed(NO_HOST)
    host = listen.partition("/")[2].rpartition(":")[0].strip("[]")
    family, address = found[0]
    with socket.socket(family, socket.SOCK_STREAM) as dialled:
        dialled.settimeout(CONNECT_S)
        try:
            dialled.connect(address)
        except OSError as error:
            return Probed(port_cause(error))
        if trust is None:
            return Probed()
        return _shake_hands(dialled, host, trust, shown, deadline_s)


def _shake_hands(dialled: socket.socket, host: str, trust: ssl.SSLContext, shown: bool, deadline_s: float) -> Probed:
    try:
        dialled.settimeout(_left(HANDSHAKE_S, deadline_s))
        with trust.wrap_socket(dialled, server_hostname=host) as link:
            told: Any = link.getpeercert()  # it was verified, so it is there
            name = next((value for part in told["subject"] for key, value in part if key == "commonName"), "")
            ends = datetime.fromtimestamp(ssl.cert_time_to_seconds(told["notAfter"]), UTC)
            return Probed(_refusal(link, shown, deadline_s), name, ends)
    except ssl.SSLCertVerificationError as error:
        return Probed(theirs(error.verify_message, host, datetime.now(UTC)))
    except TimeoutError:
        return Probed(HANGS)
    except (ssl.SSLError, OSError):  # it speaks something else, or hung up
        return Probed(NO_TLS)


def _refusal(link: ssl.SSLSocket, shown: bool, deadline_s: float) -> str | None:
    """Why the other end turns our certificate down, which it says once the handshake is over for us. Who accepts it
    waits for us to speak."""
    link.settimeout(_left(REFUSAL_S, deadline_s))
    try:
        link.recv(1)
    except TimeoutError:
        return None
    except ssl.SSLError as error:
        return ours(error.reason or "", shown)
    except OSError:
        return NO_TLS
    return NO_TLS  # it spoke first, or hung up without a reason: no agent does


def speaks_tls(listen: str) -> bool:
    """Whether who listens there speaks TLS, whatever certificates it has. For an open fleet."""
    trust = ssl.create_default_context()
    trust.check_hostname, trust.verify_mode = False, ssl.CERT_NONE
    for family, address in addresses_of(listen)[:1]:
        with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_STREAM) as dialled:
            dialled.settimeout(REFUSAL_S)
            dialled.connect(address)
            with trust.wrap_socket(dialled):
                return True
    return False


def _left(most_s: float, deadline_s: float) -> float:
    return max(0.05, min(most_s, deadline_s - machine.monotonic_s()))


# --- identity of the onlooker ---
# As whom a fleet is looked at, and what that name has on this computer to show for it.


class Who(NamedTuple):
    name: str
    trust: ssl.SSLContext | None = None  # what a probe shows and trusts; None: of an open fleet, or without ca.pem
    has_pair: bool = False  # it has a certificate to show
    keys: Path | None = None  # folder of certificates


def who_looks(fleet: Fleet, path: Path, asked: str | None) -> Who:
    """The party that was asked for; else the first console or observer, or a robot that is here, whose certificate lies
    on this computer. Of an open fleet anybody may be. Raises ConfigError where the file of another has no such name."""
    folder = keys_folder(fleet, path)
    if fleet.secured and asked is not None and asked not in parties(fleet):
        known = ", ".join(parties(fleet))
        raise ConfigError(f"--as {asked}: no such robot, observer or console; {path} has {known}")
    if not fleet.secured or folder is None:
        return Who(asked or (fleet.access.consoles or (LOOKER,))[0])
    folder = folder.absolute()
    name = asked or _first_with_key(fleet, folder)
    pair = None
    try:
        check_pair(folder, name)
        pair = str(certificate_file(folder, name)), str(key_file(folder, name))
    except ConfigError:
        pass  # said where the files of this computer are looked at
    try:
        trust = context(str(certificate_file(folder, AUTHORITY)), pair)
    except OSError:  # of which an SSLError is one
        trust = None
    return Who(name, trust, pair is not None, folder)


def _first_with_key(fleet: Fleet, folder: Path) -> str:
    here = [robot for robot in fleet.robot if is_here(fleet.robot[robot].listen)]
    names = [*fleet.access.consoles, *fleet.access.observers, *here, LOOKER]
    return next((name for name in names if key_file(folder, name).exists()), names[0])


# --- lines and JSON ---
# What the doctor has found, in lines for people and as JSON for programs.


class Diagnosis(NamedTuple):
    """All findings, in the order in which they were made."""

    findings: tuple[Finding, ...]
    name: str  # as whom it was looked

    @property
    def well(self) -> bool:
        return all(finding.level == "ok" for finding in self.findings)

    @property
    def verdict(self) -> str:
        """One line at the end."""
        count = sum(finding.level != "ok" for finding in self.findings)
        things = "one thing" if count == 1 else f"{count} things"
        return "well" if self.well else f"not well: {things} to mend"

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        about = {"well": self.well, "verdict": self.verdict, "as": self.name}
        return {**about, "findings": [finding._asdict() for finding in self.findings]}


# --- all ports ---
# The ports of all robots, dialled at the same time, and what is to be said of each.


def probe_all(fleet: Fleet, who: Who) -> dict[str, Probed]:
    """What came of dialling each robot once; all of it takes as long as the slowest."""

    def dial(name: str) -> Probed:
        listen = fleet.robot[name].listen
        probed = probe(listen, who.trust, who.has_pair)
        if probed.cause is None and not fleet.secured and speaks_tls(listen):
            return Probed("listens on tls/, and our file has tcp/: the fleet is secured; take its newest file")
        return probed

    with ThreadPoolExecutor(len(fleet.robot)) as pool:
        return dict(zip(fleet.robot, pool.map(dial, fleet.robot), strict=True))


def is_open(name: str, probed: Probed) -> bool:
    """Whether a link may come about: somebody answers, and is who should."""
    return probed.cause is None and probed.name in ("", name)


def port_findings(fleet: Fleet, name: str, probed: Probed) -> Iterator[Finding]:
    """What is wrong with one robot's port or with the certificates."""
    listen = fleet.robot[name].listen
    if probed.cause is not None:
        yield Finding("wrong", name, f"{listen}: {probed.cause}")
    if not is_open(name, probed) and probed.name and probed.name != name:
        text = f"shows the certificate of '{probed.name}': one of the two files names the other's address"
        yield Finding("wrong", name, f"{listen}: {text}; correct listen, or copy {name}'s own certificate there")
    if probed.ends is not None and (left := (probed.ends - datetime.now(UTC)) / timedelta(days=1)) < SOON_DAYS:
        text = f"its certificate expires in {left:.0f} days; make another, and start its agent again"
        yield Finding("warning", name, f"{listen}: {text}")


# --- `aucamp doctor` ---


def examine(path: Path, name: str | None, folder: Path) -> Diagnosis:
    """Look at a running fleet as `name`, or as who_looks chooses. `folder`: where agents of this computer record.

    Raises ConfigError for a file that cannot be used and for a name that is not in it.
    """
    fleet = load_fleet(path)
    who = who_looks(fleet, path, name)
    found = (*_from_here(fleet, path, who, folder), *_from_outside(fleet, who))
    return Diagnosis(tuple(dict.fromkeys(found)), who.name)


def _from_here(fleet: Fleet, path: Path, who: Who, folder: Path) -> Iterator[Finding]:
    """What this computer has, as `aucamp check` sees it. Its ports are not asked for: an agent has them by now."""
    if not fleet.secured:
        yield Finding("ok", "fleet", OPEN)
    yield from loopback_findings(fleet)
    here = [robot for robot in fleet.robot if is_here(fleet.robot[robot].listen)]
    for robot in here:
        yield from running_findings(fleet, robot, path)
    if here:
        yield from computer_findings(here, folder)
    if who.name not in here:
        yield from certificate_findings(fleet, who.name, path)


def _from_outside(fleet: Fleet, who: Who) -> Iterator[Finding]:
    """What the network shows: ports and handshakes, then links and what comes over them."""
    probed = probe_all(fleet, who)
    for name in fleet.robot:
        yield from port_findings(fleet, name, probed[name])
    there = [name for name in fleet.robot if is_open(name, probed[name])]
    if not there:
        return
    if fleet.secured and (who.name in fleet.robot or not who.has_pair or who.trust is None):
        text = "ports and certificates alone were tried; the rest is shown to observers and consoles: --as NAME"
        yield Finding("ok", who.name, text)
        return
    asks = not fleet.secured or who.name in fleet.access.consoles
    looker = Looker(observer_config(fleet, who.name, who.keys), who.name, asks, not why_closed(fleet, who.name))
    facts = listen(fleet, looker, there, fleet_clock(fleet).now_ns)
    found = [
        *robot_findings(fleet, facts, there, {name: metadata(fleet, name) for name in there}),
        *neighbour_findings(fleet, facts, [name for name in there if name in facts.states]),
    ]
    offsets = {name: best(stamps) for name, stamps in facts.stamps.items()}
    for name, late_ns in facts.late_ns.items():
        if (finding := clock_finding(name, offsets.get(name), late_ns)) is not None:
            found.append(finding)
    yield from found
    ill = {finding.about for finding in found if finding.level == "wrong"}
    ill |= {name for name, state in facts.states.items() if state.mode != "running"}  # what it says may be of before
    in_order = [name for name in there if name in facts.states and name not in ill]
    yield from (_in_order(robot_view(facts.states[name], fleet), facts, offsets.get(name)) for name in in_order)


def _measured(offset: Offset, late_ns: int) -> Iterator[str]:
    yield f"there and back {offset.way_s * 1e3:.1f} ms, a state takes {late_ns * 1e-6 + offset.ahead_s * 1e3:.1f} ms"
    yield f"clock {offset.ahead_s * 1e3:+.1f} ms"


def _in_order(view: RobotView, facts: Facts, offset: Offset | None) -> Finding:
    """What there is to say of a robot that is heard."""
    state, name = view.said, view.said.robot
    said: Sequence[str] = (
        "is linked and heard",
        f"hears {', '.join(view.hears) or 'nobody'}",
        *((view.motors,) if view.motors else ()),
        *((f"battery {state.battery_v:.1f} V",) if state.battery_v is not UNSET else ()),
        *(_measured(offset, facts.late_ns[name]) if offset else ()),
        *((f"believed not: {', '.join(f'{n} {kind}' for kind, n in state.refused.items())}",) if state.refused else ()),
    )
    return Finding("ok", name, "; ".join(said))
