// A CiA 404 node on another maker's CANopen stack (canopen of node-canopen). Frames come and go as lines, "<identifier>
// <data>" in hex, on standard input and output; the other end is an emulated CAN adapter. Runs until its input ends.
// With an argument it sends its TPDOs at this interval, ms, instead of after SYNC.
// Further lines it obeys: "stop heartbeat", "start heartbeat" and "emergency <code> <register>".
"use strict";
const Module = require("node:module");
const load = Module._load;
// A compiled add-on that only block transfers need, which neither side uses here.
const crc = () => { throw new Error("no block transfers"); };
Module._load = (name, ...rest) => (name === "node-crc" ? { crc } : load(name, ...rest));
const { Device, Eds, DataType, ObjectType, AccessType } = require("canopen");

const NODE = 5;
const HEARTBEAT_MS = 1000;
const EVENT_MS = Number(process.argv[2] || 0);
const accessType = AccessType.READ_ONLY;
const eds = new Eds();

function variable(index, parameterName, dataType, defaultValue) {
  const entry = eds.getEntry(index);
  if (entry) entry.value = defaultValue;
  else eds.addEntry(index, { parameterName, dataType, defaultValue, accessType });
}

function array(index, parameterName, dataType, values) {
  const entry = eds.addEntry(index, { parameterName, objectType: ObjectType.ARRAY });
  return values.map((defaultValue, i) =>
    entry.addSubObject(i + 1, { parameterName: `${parameterName} ${i + 1}`, dataType, defaultValue, accessType }));
}

// Not by addTransmitPdo, which cannot map objects from 8000 on: its index << 16 is negative.
function tpdo(number, cobId, mapped) {
  const add = (index, parameterName, entries) => {
    const entry = eds.addEntry(index + number, { parameterName, objectType: ObjectType.RECORD });
    entries.forEach(([dataType, defaultValue], i) =>
      entry.addSubObject(i + 1, { parameterName: `${parameterName} ${i + 1}`, dataType, defaultValue, accessType }));
  };
  add(0x1800, "TPDO communication parameter", [[DataType.UNSIGNED32, cobId], [DataType.UNSIGNED8, EVENT_MS ? 254 : 1],
    ...(EVENT_MS ? [[DataType.UNSIGNED16, 0], [DataType.UNSIGNED8, 0], [DataType.UNSIGNED16, EVENT_MS]] : [])]);
  add(0x1a00, "TPDO mapping parameter", mapped.map((object) =>
    [DataType.UNSIGNED32, object.index * 0x10000 + object.subIndex * 0x100 + object.size * 8]));
}

variable(0x1000, "Device type", DataType.UNSIGNED32, 0x00020000 + 404);
array(0x6110, "Sensor type", DataType.UNSIGNED16, [30, 30]);
array(0x6131, "Physical unit", DataType.UNSIGNED32, [0x002d0000, 0x002d0000]);
array(0x6132, "Decimal digits", DataType.UNSIGNED8, [2, 2]);
const status = array(0x6150, "Status", DataType.UNSIGNED8, [0, 1]);
const values = array(0x9130, "Process value", DataType.INTEGER32, [-1234, 85000]);
eds.setSyncCobId(0x80);
eds.setEmcyCobId(0x80 + NODE);
eds.setErrorRegister(0);
eds.addSdoServerParameter(0, 0x580 + NODE, 0x600 + NODE);
eds.setHeartbeatProducerTime(HEARTBEAT_MS);
tpdo(0, 0x180 + NODE, values);
tpdo(1, 0x280 + NODE, status);

const device = new Device({ id: NODE, eds });
let beats = true;
device.on("message", ({ id, data }) => {
  if (beats || id !== 0x700 + NODE) console.log(id.toString(16), Buffer.from(data).toString("hex"));
});

function obey(line) {
  const words = line.split(" ");
  switch (words[0]) {
    case "stop": beats = false; break;
    case "start": beats = true; break;
    case "emergency":
      eds.setErrorRegister(parseInt(words[2], 16));
      device.emcy.write(parseInt(words[1], 16));
      break;
    default: {
      const data = Buffer.from(words[1] || "", "hex");
      device.receive({ id: parseInt(words[0], 16), data, len: data.length });
    }
  }
}

console.log("listening on", NODE);
device.start();
require("node:readline").createInterface({ input: process.stdin }).on("line", obey).on("close", () => process.exit(0));
