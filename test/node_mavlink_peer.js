// An autopilot that speaks MAVLink by node-mavlink: node node_mavlink_peer.js PORT [PASSPHRASE]
//
// It sends a heartbeat, answers TIMESYNC, sends ODOMETRY once asked to, as often as asked for, and
// prints each ODOMETRY that comes back as a line of JSON. It ends with its standard input.

const dgram = require('dgram')
const mavlink = require('node-mavlink')

const { minimal, common, MavLinkPacketSignature, MavLinkPacketSplitter, MavLinkPacketParser } = mavlink
const REGISTRY = { ...minimal.REGISTRY, ...common.REGISTRY }
const [port, passphrase] = process.argv.slice(2)
const key = passphrase && MavLinkPacketSignature.key(passphrase)
const protocol = new mavlink.MavLinkProtocolV2(1, 1, key ? 1 : 0)
const socket = dgram.createSocket('udp4')
let sequence = 0
let signedMs = 0
let stream

function send(fields, message) {
  let packet = protocol.serialize(Object.assign(message, fields), sequence)
  sequence = (sequence + 1) % 256
  if (key) {
    signedMs = Math.max(signedMs + 1, Date.now()) // two in one millisecond would be a replay
    packet = protocol.sign(packet, 0, key, signedMs)
  }
  socket.send(packet, port, '127.0.0.1')
}

function sendOdometry() {
  send({
    timeUsec: process.hrtime.bigint() / 1000n,
    frameId: common.MavFrame.LOCAL_NED, childFrameId: common.MavFrame.BODY_FRD,
    x: 1, y: 2, z: -3, q: [Math.SQRT1_2, 0, 0, Math.SQRT1_2], // facing east
    vx: 4, vy: 0, vz: 0, rollspeed: 0, pitchspeed: 0, yawspeed: 0,
    poseCovariance: Array(21).fill(NaN), velocityCovariance: Array(21).fill(NaN),
    resetCounter: 0, estimatorType: 0, quality: 0,
  }, new common.Odometry())
}

const answers = {
  TIMESYNC(request) {
    if (request.tc1 === 0n) {
      send({ tc1: process.hrtime.bigint(), ts1: request.ts1 }, new common.TimeSync())
    }
  },
  COMMAND_LONG(command) {
    const accepted = command.command === common.MavCmd.SET_MESSAGE_INTERVAL &&
      command._param1 === common.Odometry.MSG_ID
    if (accepted) {
      clearInterval(stream)
      stream = setInterval(sendOdometry, command._param2 / 1000)
    }
    send({ command: command.command, result: accepted ? 0 : 2 }, new common.CommandAck())
  },
  ODOMETRY(odometry) {
    console.log(JSON.stringify(
      odometry, (_, value) => typeof value === 'bigint' ? Number(value) : value))
  },
}

const splitter = new MavLinkPacketSplitter()
splitter.pipe(new MavLinkPacketParser()).on('data', packet => {
  const kind = REGISTRY[packet.header.msgid]
  const answer = kind && answers[kind.MSG_NAME]
  if (answer && (!key || packet.signature.matches(key))) {
    answer(packet.protocol.data(packet.payload, kind))
  }
})
socket.on('message', data => splitter.write(data))

function beat() {
  send({ type: 2, autopilot: 12, baseMode: 0, customMode: 0, systemStatus: 4, mavlinkVersion: 3 },
    new minimal.Heartbeat())
}
beat()
setInterval(beat, 200)
process.stdin.on('end', () => process.exit()).resume()
