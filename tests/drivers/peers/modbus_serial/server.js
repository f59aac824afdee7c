// Modbus TCP units on another maker's stack (modbus-serial): unit 1 an ADAM-6015, unit 2 a coupler with a 750-464.
// Prints its port, then serves until its standard input ends. Unit 9 never answers; other addresses are refused.
"use strict";
const { ServerTCP } = require("modbus-serial");

const COUNTS = [0x8000, 0x4000, 0xc000, 1, 0xfffe, 0xffff, 0x8000]; // input 5 at its end, input 6 burnt out
const HOLDING = new Map();
COUNTS.forEach((counts, i) => { HOLDING.set(i, counts); HOLDING.set(200 + i, 0x03a4); });
const INPUT = [0x00, 213, 0x41, 0xf830, 0x62, 8500, 0x00, 0xffdf]; // status and value, four times

function illegalAddress() {
  return { modbusErrorCode: 2, message: "illegal data address" };
}

function answer(unit, found, done) {
  if (unit === 9) return;
  if (found === undefined) done(illegalAddress());
  else done(null, found);
}

const units = {
  getHoldingRegister: (address, unit, done) => answer(unit, unit === 1 ? HOLDING.get(address) : undefined, done),
  getInputRegister: (address, unit, done) => answer(unit, unit === 2 ? INPUT[address] : undefined, done),
  getCoil: (address, unit, done) =>
    answer(unit, unit === 1 && address >= 120 && address < 127 ? address === 126 : undefined, done),
};

// As a text, because the number 0 would be taken for "the usual port".
const server = new ServerTCP(units, { host: "127.0.0.1", port: "0", unitID: 255 });
server.on("initialized", () => console.log("listening on", server._server.address().port));
server.on("socketError", () => {});
process.stdin.on("end", () => process.exit(0)).resume();
