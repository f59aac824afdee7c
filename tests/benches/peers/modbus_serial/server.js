// Modbus units on another maker's stack (modbus-serial). Over TCP: unit 1 an ADAM-6015, unit 2 a coupler with a 750-464.
// With the path of a serial port as argument, on that line: unit 3 an M-7015, unit 4 a PTA8D08.
// With the argument "closing": over TCP, and each connection ends after its first answer.
// Prints its port or path, then serves until its standard input ends. Unit 9 never answers; other addresses are refused.
"use strict";
const { ServerSerial, ServerTCP } = require("modbus-serial");

const COUNTS = [0x8000, 0x4000, 0xc000, 1, 0xfffe, 0xffff, 0x8000]; // input 5 at its end, input 6 burnt out
const HOLDING = new Map();
COUNTS.forEach((counts, i) => { HOLDING.set(i, counts); HOLDING.set(200 + i, 0x03a4); });
const INPUT = [0x00, 213, 0x41, 0xf830, 0x62, 8500, 0x00, 0xffdf]; // status and value, four times

const M7015 = [200, 213, 0xffdf, 400, 0x7fff, 222]; // input 4 open
const PTA8D08 = [200, 213, 0xffdf, 400, 977, 222, 234, 1200]; // input 4 open, which looks like 97.7 degC

function illegalAddress() {
  return { modbusErrorCode: 2, message: "illegal data address" };
}

function answer(unit, found, done) {
  if (unit === 9) return;
  if (found === undefined) done(illegalAddress());
  else done(null, found);
}

const units = {
  getHoldingRegister: (address, unit, done) => answer(unit, {
    1: HOLDING.get(address),
    3: address >= 256 && address < 262 ? 0x2e : undefined,
    4: PTA8D08[address],
  }[unit], done),
  getInputRegister: (address, unit, done) => answer(unit, { 2: INPUT[address], 3: M7015[address] }[unit], done),
  getDiscreteInput: (address, unit, done) =>
    answer(unit, unit === 3 && address >= 128 && address < 134 ? address === 132 : undefined, done),
  getCoil: (address, unit, done) => answer(unit, {
    1: address >= 120 && address < 127 ? address === 126 : undefined,
    3: address === 268 ? true : undefined,
  }[unit], done),
};

const closing = process.argv[2] === "closing";
const path = closing ? undefined : process.argv[2];
if (path) {
  const server = new ServerSerial(units, { path, baudRate: 19200, unitID: 255, interval: 5 });
  server.on("initialized", () => console.log("listening on", path));
} else {
  // The port as a text, because the number 0 would be taken for "the usual port".
  const server = new ServerTCP(units, { host: "127.0.0.1", port: "0", unitID: 255 });
  server.on("initialized", () => console.log("listening on", server._server.address().port));
  server.on("socketError", () => {});
  if (closing) server._server.prependListener("connection", (socket) => { socket.write = (answer) => socket.end(answer); });
}
process.stdin.on("end", () => process.exit(0)).resume();
