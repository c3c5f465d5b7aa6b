// Prints every OSC message that node-osc decodes, one JSON line each. Arguments: ports.
const { Server } = require('node-osc');

const ports = process.argv.slice(2).map(Number);
let left = ports.length;
for (const port of ports) {
  const server = new Server(port, '127.0.0.1');
  const heard = ([address, ...args]) => console.log(JSON.stringify([port, address, args]));
  server.on('message', heard);
  server.on('bundle', (bundle) => bundle.elements.forEach(heard));
  server.on('error', (error) => { console.error(error); process.exit(1); });
  server.on('listening', () => { if (--left === 0) console.log('ready'); });
}
