// An IO-Link master with the types of the companion specification (OPC 30120, the OPC Foundation's own nodeset), on another
// maker's OPC UA stack. Each device holds the process data that its argument says: name=hexadecimal bytes.
// Usage: node io_link.js <pki folder> <device>=<bytes>...
// Prints its URL, then serves until its standard input ends. Lines that it takes there: `<device> <bytes> <StatusCode>`;
// it answers each with a line.
"use strict";
const readline = require("readline");
const opcua = require("node-opcua");

const [folder, ...devices] = process.argv.slice(2);

async function main() {
  const certificates = new opcua.OPCUACertificateManager({ rootFolder: folder, automaticallyAcceptUnknownCertificate: false });
  await certificates.initialize();
  const { standard, di, iolink } = opcua.nodesets;
  const server = new opcua.OPCUAServer({
    port: 0,
    hostname: "127.0.0.1",
    host: "127.0.0.1",
    nodeset_filename: [standard, di, iolink],
    serverCertificateManager: certificates,
    userCertificateManager: certificates,
    securityModes: [opcua.MessageSecurityMode.None],
    securityPolicies: [opcua.SecurityPolicy.None],
    allowAnonymous: true,
    serverInfo: { applicationUri: "urn:peer:io-link" },
  });
  await server.initialize();

  const space = server.engine.addressSpace;
  const own = space.registerNamespace("urn:maker:io-link-master");
  const types = space.getNamespaceIndex("http://opcfoundation.org/UA/IOLink/");
  const type = space.findObjectType("IOLinkDeviceType", types);
  const data = {};

  function set(name, bytes, status) {
    const value = { dataType: opcua.DataType.Byte, arrayType: opcua.VariantArrayType.Array, value: Buffer.from(bytes, "hex") };
    data[name].setValueFromSource(value, opcua.StatusCodes[status]);
  }

  for (const device of devices) {
    const [name, bytes] = device.split("=");
    const object = type.instantiate({
      browseName: name, namespace: own, organizedBy: space.rootFolder.objects, nodeId: `s=${name}`,
    });
    const found = object.getChildByName("ParameterSet")?.getChildByName("ProcessDataInput") ?? object.getChildByName("ProcessDataInput");
    data[name] = found;
    set(name, bytes, "Good");
    process.stdout.write(`${name} ${found.nodeId.toString()}\n`);
  }

  await server.start();
  process.stdout.write(`listening on opc.tcp://127.0.0.1:${server.endpoints[0].port}\n`);
  readline.createInterface({ input: process.stdin }).on("line", (line) => {
    set(...line.split(" "));
    process.stdout.write("done\n");
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
