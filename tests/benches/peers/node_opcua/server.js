// A control with SINUMERIK's names on another maker's OPC UA stack, with its own small part program.
// Usage: node server.js <pki folder> [<certificate.pem> <key.pem> <trusted client.der>]
// Prints its URL, then serves until its standard input ends. Lines that it takes there: `allow` (the program reaches safe
// points from now on), `alarm <number>`, `clear`. SLOW=1 in the environment: none before `allow`, and cycles of three seconds.
"use strict";
const fs = require("fs");
const readline = require("readline");
const opcua = require("node-opcua");

const [folder, certificateFile, privateKeyFile, trusted] = process.argv.slice(2);
const AXES = { 1: 10.5, 2: -20.25, 3: 150.0, 4: 30.0, 5: 270.0 };

const CENTRES = [[120, 0, 80], [0, 120, 80], [-120, 0, 80], [0, -120, 80], [120, -80, 0], [120, 80, 0]];

async function main() {
  const certificates = new opcua.OPCUACertificateManager({ rootFolder: folder, automaticallyAcceptUnknownCertificate: false });
  await certificates.initialize();
  const secure = certificateFile !== undefined;
  if (secure) await certificates.trustCertificate(fs.readFileSync(trusted));
  const server = new opcua.OPCUAServer({
    port: 0,
    hostname: "127.0.0.1",
    host: "127.0.0.1",
    serverCertificateManager: certificates,
    userCertificateManager: certificates,
    ...(secure ? { certificateFile, privateKeyFile } : {}),
    securityModes: [secure ? opcua.MessageSecurityMode.SignAndEncrypt : opcua.MessageSecurityMode.None],
    securityPolicies: [secure ? opcua.SecurityPolicy.Basic256Sha256 : opcua.SecurityPolicy.None],
    allowAnonymous: !secure,
    userManager: { isValidUser: (user, password) => user === "gateway" && password === "secret" },
    serverInfo: { applicationUri: "urn:peer:server" },
  });
  await server.initialize();

  const space = server.engine.addressSpace;
  space.registerNamespace("urn:somebody:else"); // so that the index is not what one would guess
  const own = space.registerNamespace("SinumerikVarProvider");
  const root = own.addObject({ organizedBy: space.rootFolder.objects, browseName: "Sinumerik" });
  const r = new Array(100).fill(0.0);

  function show(path, dataType, get, set) {
    own.addVariable({
      componentOf: root,
      browseName: path,
      nodeId: `s=${path}`,
      dataType,
      minimumSamplingInterval: 20,
      accessLevel: set ? "CurrentRead | CurrentWrite" : "CurrentRead",
      value: {
        get: () => new opcua.Variant({ dataType: opcua.DataType[dataType], value: get() }),
        ...(set ? { set: (variant) => (set(variant.value), opcua.StatusCodes.Good) } : {}),
      },
    });
  }

  const k0 = [0.0, 0.0, 0.0];
  const slow = process.env.SLOW === "1";
  let allowed = !slow, alarm = 0, waiting = 0, began = 0, heard = 0, ticked = Date.now();

  function answer(state, reason) {
    r[66] = reason;
    r[65] = state;
    if (state > 2) began = 0;
  }

  function safePoint() {
    if (!waiting || began) return;
    const reason = alarm ? 1 : r[61] === waiting ? 4 : 0;
    if (!reason && !allowed) return;
    r[65] = 0;
    r[67] = 0;
    r[64] = waiting;
    waiting = 0;
    if (reason) return answer(4, reason);
    began = Date.now();
    answer(1, 0);
  }

  function cycle(now) {
    if (!began) return;
    if (alarm) return answer(5, 1);
    if (r[61] === r[64]) return answer(5, 4);
    if (r[65] === 1 && now - began > 30) answer(2, 0);
    if (r[65] === 2 && now - began > (slow ? 3000 : 80)) {
      CENTRES.flat().forEach((value, i) => { r[70 + i] = value + r[64] * 1e-4; });
      r[67] = r[64];
      answer(3, 0);
    }
  }

  function watchdog(now) {
    const passed = (now - ticked) / 1000;
    ticked = now;
    if (r[96] === 1 && (r[93] === 0 || now - heard > r[95] * 1000)) r[96] = 2;
    if (r[96] !== 2) return;
    for (const i of [0, 1, 2]) k0[i] -= Math.sign(k0[i]) * Math.min(Math.abs(k0[i]), passed * r[97]);
  }

  setInterval(() => { const now = Date.now(); safePoint(); cycle(now); watchdog(now); }, 5);

  function written(n, value) {
    const other = r[n] !== value;
    r[n] = value;
    if (n === 60 && value > 0 && value !== r[64]) waiting = value;
    if (n === 94 && other) {
      heard = Date.now();
      if (r[93] > 0) {
        r[96] = 1;
        r[68] = value;
      }
    }
  }

  for (const [n, position] of Object.entries(AXES)) {
    show(`/Channel/MachineAxis/actToolBasePos[u1,${n}]`, "Double", () => position);
    show(`/Channel/MachineAxis/actFeedRate[u1,${n}]`, "Double", () => 720.0);
    show(`/Channel/MachineAxis/refPtStatus[u1,${n}]`, "UInt16", () => 3);
  }
  show("/Channel/Spindle/actSpeed[u1,1]", "Double", () => 8000.0);
  show("/NC/_N_NC_TEA_ACX/$MN_SCALING_SYSTEM_IS_METRIC", "Boolean", () => true);
  show("/Plc/M120.0", "Boolean", () => true);
  show("/Plc/M120.1", "Boolean", () => r[65] === 2);
  show("/Bag/State/opMode[u1]", "UInt16", () => 2);
  show("/Channel/State/progStatus[u1]", "UInt16", () => 3);
  show("/Channel/State/actTNumber[u1]", "UInt16", () => 5);
  for (let n = 1; n <= 16; n++) show(`/Nck/SequencedAlarms/textIndex[${n}]`, "UInt32", () => (n === 1 ? alarm : 0));
  for (let n = 0; n < 100; n++) {
    show(`/Channel/Parameter/R[u1,${n}]`, "Double", () => r[n], (value) => written(n, value));
  }
  for (const n of [1, 2, 3]) {
    const writable = (value) => { k0[n - 1] = value; };
    show(`/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u${n}]`, "Double", () => k0[n - 1], writable);
    show(`/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_SLOPE[u${n}]`, "Double", () => 0.0);
    show(`/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_REF_POSITION[u${n}]`, "Double", () => 0.0);
  }

  await server.start();
  process.stdout.write(`listening on opc.tcp://127.0.0.1:${server.endpoints[0].port}\n`);
  readline.createInterface({ input: process.stdin }).on("line", (line) => {
    const [word, number] = line.split(" ");
    if (word === "allow") allowed = true;
    if (word === "alarm") alarm = Number(number);
    if (word === "clear") alarm = 0;
  });
  process.stdin.on("end", async () => {
    await server.shutdown(0);
    process.exit(0);
  });
}

main().catch((error) => {
  console.error(error);
  process.exit(1);
});
