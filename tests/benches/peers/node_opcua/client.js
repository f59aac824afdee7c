// A client on another maker's OPC UA stack.
// Usage: node client.js <pki folder> <url> [<user> <password> [<certificate.pem> <key.pem>] [-- <user> ...]]
// Prints a line for each user who is refused, until one is not: then a line of JSON with what it finds below Machines,
// another when it has tried to change all of it, and then one for each notification of EX0C. Each line `read` of its
// standard input brings a line of the first kind. It ends with that.
"use strict";
const readline = require("readline");
const opcua = require("node-opcua");

const [folder, url, ...words] = process.argv.slice(2);
const users = words.join("\n").split("\n--\n").map((each) => each.split("\n").filter(Boolean));
const say = (found) => process.stdout.write(JSON.stringify(found) + "\n");

async function found(session, machines, uris) {
  const nodes = {};
  async function walk(nodeId, path) {
    const answer = await session.browse({ nodeId, referenceTypeId: "HierarchicalReferences", includeSubtypes: true,
      browseDirection: opcua.BrowseDirection.Forward, resultMask: 63 });
    for (const reference of answer.references) {
      const name = reference.browseName.name, place = path ? `${path}/${name}` : name;
      const node = { id: reference.nodeId.toString(), uri: uris[reference.browseName.namespaceIndex],
        type: [uris[reference.typeDefinition.namespace], reference.typeDefinition.value] };
      if (reference.nodeClass === opcua.NodeClass.Variable) {
        const read = await session.read({ nodeId: reference.nodeId, attributeId: opcua.AttributeIds.Value });
        node.value = read.value.value;
        node.status = read.statusCode.name;
        node.source = read.sourceTimestamp;
      }
      nodes[place] = node;
      await walk(reference.nodeId, place);
    }
  }
  await walk(machines, "");
  return nodes;
}

async function tried(session, nodes) {
  const answers = {};
  const value = { statusCode: opcua.StatusCodes.Good, value: { dataType: opcua.DataType.Double, value: 1.0 } };
  for (const [place, node] of Object.entries(nodes)) {
    for (const attribute of ["Value", "DisplayName", "AccessLevel"]) {
      const attributeId = opcua.AttributeIds[attribute];
      const answer = await session.write({ nodeId: node.id, attributeId, value });
      answers[`${attribute} of ${place}`] = answer.name;
    }
  }
  const first = Object.values(nodes)[0].id;
  const requests = {
    DeleteNodes: new opcua.DeleteNodesRequest({ nodesToDelete: [{ nodeId: first, deleteTargetReferences: true }] }),
    AddNodes: new opcua.AddNodesRequest({ nodesToAdd: [{ parentNodeId: first, referenceTypeId: "i=47",
      browseName: { name: "foreign" }, nodeClass: opcua.NodeClass.Object, typeDefinition: "i=58" }] }),
  };
  for (const [name, request] of Object.entries(requests)) {
    try {
      const answer = await session.performMessageTransaction(request);
      answers[name] = (answer.results[0].statusCode ?? answer.results[0]).name;
    } catch (error) {
      answers[name] = String(error.message).match(/Bad\w+/)?.[0] ?? String(error.message);
    }
  }
  return answers;
}

async function visit(certificates, [user, password, certificateFile, privateKeyFile]) {
  const secure = certificateFile !== undefined;
  const client = opcua.OPCUAClient.create({
    clientCertificateManager: certificates,
    ...(secure ? { certificateFile, privateKeyFile, applicationUri: "urn:peer:server" } : {}),
    securityMode: secure ? opcua.MessageSecurityMode.SignAndEncrypt : opcua.MessageSecurityMode.None,
    securityPolicy: secure ? opcua.SecurityPolicy.Basic256Sha256 : opcua.SecurityPolicy.None,
    endpointMustExist: false,
    connectionStrategy: { maxRetry: 0 },
  });
  await client.connect(url);
  const who = user ? { type: opcua.UserTokenType.UserName, userName: user, password } : undefined;
  const session = await client.createSession(who);
  const uris = await session.readNamespaceArray();
  const machines = `ns=${uris.indexOf("http://opcfoundation.org/UA/Machinery/")};i=1001`;
  const nodes = await found(session, machines, uris);
  say(nodes);
  say(await tried(session, nodes));
  const subscription = await session.createSubscription2({ requestedPublishingInterval: 100, requestedLifetimeCount: 1000,
    requestedMaxKeepAliveCount: 10, publishingEnabled: true });
  const place = Object.keys(nodes).find((name) => name.endsWith("ThermalErrors/EX0C"));
  const item = await subscription.monitor({ nodeId: nodes[place].id, attributeId: opcua.AttributeIds.Value },
    { samplingInterval: 0, queueSize: 100, discardOldest: true }, opcua.TimestampsToReturn.Both);
  item.on("changed", (data) => say({ value: data.value.value, status: data.statusCode.name, source: data.sourceTimestamp }));
  for await (const line of readline.createInterface({ input: process.stdin })) {
    if (line === "read") say(await found(session, machines, uris));
  }
  await session.close(true);
  await client.disconnect();
  process.exit(0);
}

async function main() {
  const certificates = new opcua.OPCUACertificateManager({ rootFolder: folder, automaticallyAcceptUnknownCertificate: true });
  await certificates.initialize();
  for (const each of users) await visit(certificates, each).catch((error) => say({ refused: String(error.message) }));
  process.exit(1);
}

main();
