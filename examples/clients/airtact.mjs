// A client of `airtact live SCENE --from websocket` for browsers and Node (22, or 20 with --experimental-websocket).
//
//   node airtact.mjs [ADDRESS]
//
// connects to `airtact live touch_ball --from websocket`, adds a ball and a focus on the index finger, and prints the state
// for two seconds.

export class Client {
  /** Connect; `onState` and `onRejected` are called with each message of the loop. */
  constructor(address = "ws://127.0.0.1:8765", { onState = () => {}, onRejected = console.warn } = {}) {
    this.state = null; // newest state: { state, reason, contacts, foci }
    this.socket = new WebSocket(address);
    this.opened = new Promise((resolve, reject) => {
      this.socket.onopen = resolve;
      this.socket.onerror = () => reject(new Error(`nothing listens at ${address}`));
    });
    this.socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      if (message.type === "state") onState((this.state = message));
      else if (message.type === "rejected") onRejected(message.reason);
    };
  }

  /** Ask for these foci instead of the earlier ones. Call it several times per second. */
  foci(...foci) {
    this.send({ type: "foci", foci });
  }

  /** Change objects: { add: [...], move: [{ name, pose }], remove: [names] }. */
  objects(changes) {
    this.send({ type: "objects", ...changes });
  }

  /** Send frames of hands: { time, side, sequence, landmarks }. */
  hands(...hands) {
    this.send({ type: "hands", hands });
  }

  /** Remove all foci and objects of this client. */
  clear() {
    this.send({ type: "clear" });
  }

  send(message) {
    this.socket.send(JSON.stringify({ version: 1, ...message }));
  }

  close() {
    this.socket.close();
  }
}

if (globalThis.process?.argv[1]?.endsWith("airtact.mjs")) {
  const client = new Client(process.argv[2]);
  await client.opened;
  client.objects({ add: [{ name: "ball", sphere: { radius: 0.02 }, pose: { translation: [0, 0, 0.2] } }] });
  for (let turn = 0; turn < 20; turn++) {
    client.foci({ id: "tip", place: "index.pad", strength: 0.5 });
    await new Promise((resolve) => setTimeout(resolve, 100));
    if (client.state) console.log(client.state.state, client.state.reason ?? "", JSON.stringify(client.state.foci));
  }
  client.close();
}
