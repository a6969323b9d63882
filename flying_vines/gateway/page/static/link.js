// The link to the drone: one WebSocket, which reconnects. It knows the age of the received data.

const SILENT_S = 2.0; // a message comes at least once a second, so the link is lost after this time
const OPENS_WITHIN_S = 3.0;
const FIRST_BACKOFF_S = 0.25;
const MAX_BACKOFF_S = 4.0;
const ANSWERED_WITHIN_S = 1.5;
const TRY_AGAIN_S = 0.5;
const LOOK_S = 0.2;
const WHY_NOT = {
  401: "the token changed, reload",
  503: "too many viewers",
};

export const now = () => performance.now() / 1000;

export class Link {
  // `take` gets each message. `look` is called five times a second to show the state of the link.
  constructor(take, look) {
    this.take = take;
    this.open = false;
    this.refused = "";
    this.lostAt = now();
    this.shownAt = null; // time of the latest snapshot, on the drone's clock
    this.droneTime = null; // the drone's latest clock time, and its time of arrival on our clock
    this.offset = Infinity; // our clock minus the drone's: the minimum so far
    this.backoff = FIRST_BACKOFF_S;
    this.answers = new Map();
    this.number = 0;
    this.connect();
    setInterval(() => {
      this.watch();
      look();
    }, 1000 * LOOK_S);
    // A sleeping phone runs no timers: check the link at once when it wakes up.
    document.addEventListener("visibilitychange", () => document.hidden || this.hurry());
    window.addEventListener("online", () => this.hurry());
  }

  // The present time on the drone's clock, if it is known.
  get droneNow() {
    return now() - this.offset;
  }

  // Age of the shown data, in seconds.
  get age() {
    return this.shownAt === null ? Infinity : Math.max(0, this.droneNow - this.shownAt);
  }

  connect() {
    const secure = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${secure}://${location.host}/live`);
    this.socket = socket;
    this.began = this.receivedAt = now();
    socket.onmessage = (event) => this.socket === socket && this.handle(JSON.parse(event.data));
    socket.onclose = () => this.socket === socket && this.lost();
  }

  handle(message) {
    this.receivedAt = now();
    if (message.kind === "hello") {
      this.open = true;
      this.refused = "";
      this.backoff = FIRST_BACKOFF_S;
      this.offset = this.receivedAt - message.t;
      this.droneTime = { t: message.t, at: this.receivedAt };
    } else if (message.kind === "snapshot") {
      this.shownAt = message.snapshot.t;
      this.droneTime = { t: this.shownAt, at: this.receivedAt };
      this.offset = Math.min(this.offset, this.receivedAt - this.shownAt);
    } else if (message.kind === "answer") {
      this.answers.get(message.id)?.(message);
      return;
    }
    this.take(message);
  }

  watch() {
    if (this.socket && now() - this.receivedAt > (this.open ? SILENT_S : OPENS_WITHIN_S)) this.lost();
  }

  lost() {
    const socket = this.socket;
    this.socket = null;
    socket.close();
    if (this.open) this.lostAt = this.receivedAt;
    else this.askWhy();
    this.open = false;
    this.again = setTimeout(() => this.connect(), 1000 * this.backoff * (0.75 + 0.5 * Math.random()));
    this.backoff = Math.min(2 * this.backoff, MAX_BACKOFF_S);
  }

  hurry() {
    this.backoff = FIRST_BACKOFF_S;
    if (this.socket) return this.watch();
    clearTimeout(this.again);
    this.connect();
  }

  // A browser hides why a WebSocket was refused. A plain request gets the HTTP status.
  async askWhy() {
    try {
      const response = await fetch("live");
      this.refused = WHY_NOT[response.status] ?? "";
    } catch {
      this.refused = "";
    }
  }

  // Time on the drone's clock. Delays of the link make it too early, never too late.
  get madeAt() {
    return this.droneTime && this.droneTime.t + (now() - this.droneTime.at);
  }

  // Returns safety's ruling: accepted, limited, refused, or unanswered. Late requests are refused, except vents.
  // `seenAt` is the time of the shown data: newer faults are not cleared.
  ask(command, value = null, name = null, seenAt = this.shownAt) {
    if (!this.open) return Promise.resolve({ safety: "unanswered", reason: "no link" });
    const id = this.number++;
    return new Promise((resolve) => {
      const end = (answer) => {
        clearTimeout(late);
        this.answers.delete(id);
        resolve(answer);
      };
      const late = setTimeout(() => end({ safety: "unanswered", reason: "no answer" }), 1000 * ANSWERED_WITHIN_S);
      this.answers.set(id, end);
      this.socket.send(JSON.stringify({ id, command, value, name, made_at: this.madeAt, seen_at: seenAt }));
    });
  }
}

// Repeats a vent request until it is confirmed or cancelled, also after a link loss.
export class Vent {
  constructor(link) {
    this.link = link;
    this.since = null;
    this.confirmedAfter = null;
    setInterval(() => this.wanted && this.attempt(), 1000 * TRY_AGAIN_S);
  }

  get wanted() {
    return this.since !== null && this.confirmedAfter === null;
  }

  press() {
    this.since = now();
    this.seenAt = this.link.shownAt; // later faults were not seen by the person
    this.confirmedAfter = null;
    this.attempt();
  }

  giveUp() {
    this.since = null;
  }

  async attempt() {
    const since = this.since;
    const answer = await this.link.ask("vent", null, null, this.seenAt);
    if (answer.safety !== "accepted" || since !== this.since) return;
    this.confirmedAfter ??= now() - since;
    this.doubt = answer.reason; // "not confirmed: …" if the board does not answer
  }
}
