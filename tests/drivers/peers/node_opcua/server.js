// A control with SINUMERIK's names on another maker's OPC UA stack, with its own small part program.
// Usage: node server.js <pki folder> [<certificate.pem> <key.pem> <trusted client.der>]
// Prints its URL, then serves until its standard input ends.
"use strict";
const fs = require("fs");
const opcua = require("node-opcua");

const [folder, certificateFile, privateKeyFile, trusted] = process.argv.slice(2);
const AXES = { 1: 10.5, 2: -20.25, 3: 150.0, 4: 30.0, 5: 270.0 };

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

  function probe(number) {
    r[65] = 0;
    r[67] = 0;
    r[64] = number;
    r[65] = 1;
    setTimeout(() => { r[65] = 2; }, 30);
    setTimeout(() => {
      for (let i = 0; i < 18; i++) r[70 + i] = number + i / 1000;
      r[67] = number;
      r[65] = 3;
    }, 80);
  }

  for (const [n, position] of Object.entries(AXES)) {
    show(`/Channel/MachineAxis/actToolBasePos[u1,${n}]`, "Double", () => position);
    show(`/Channel/MachineAxis/actFeedRate[u1,${n}]`, "Double", () => 720.0);
  }
  show("/Channel/Spindle/actSpeed[u1,1]", "Double", () => 8000.0);
  show("/Plc/M120.0", "Boolean", () => true);
  show("/Plc/M120.1", "Boolean", () => r[65] === 2);
  show("/Bag/State/opMode[u1]", "UInt16", () => 2);
  show("/Channel/State/progStatus[u1]", "UInt16", () => 3);
  show("/Channel/State/actTNumber[u1]", "UInt16", () => r[99]);
  for (const n of [1, 2, 3]) show(`/Nck/SequencedAlarms/textIndex[${n}]`, "UInt32", () => (n === 1 ? 4711 : 0));
  for (let n = 0; n < 100; n++) {
    show(`/Channel/Parameter/R[u1,${n}]`, "Double", () => r[n], (value) => {
      r[n] = value;
      if (n === 60) probe(value);
    });
  }
  for (const n of [1, 2, 3]) {
    let k0 = 0.0;
    const writable = (value) => { k0 = value; };
    show(`/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u${n}]`, "Double", () => k0, writable);
    show(`/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_SLOPE[u${n}]`, "Double", () => 0.0);
    show(`/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_REF_POSITION[u${n}]`, "Double", () => 0.0);
  }

  await server.start();
  process.stdout.write(`listening on opc.tcp://127.0.0.1:${server.endpoints[0].port}\n`);
  process.stdin.resume();
  process.stdin.on("end", async () => {
    await server.shutdown(0);
    process.exit(0);
  });
}

main().catch((error) => {
  console.error(error);
  process.exit(1);
});
