--[[
Hands the numbers of DO_SEND_SCRIPT_MESSAGE mission items to the companion computer that moves the vine.

ArduPilot reports such an item to a companion only by the status text "Mission: 3 Scripting". This script also
sends its four numbers exactly, as COMMAND_LONG MAV_CMD_USER_1 to one component of this vehicle. It sends the
command up to four times, until it is acknowledged. Needs ArduPilot 4.5 or newer. README.md describes the
installation.

  VINE_COMP  component id of the companion (vehicle.component_id of its configuration)
  VINE_CHAN  MAVLink channel to send on; -1: the channel on which that component sends
--]]

local TABLE_KEY = 93
local UPDATE_MS = 10
local RETRY_AFTER_ERROR_MS = 1000
local REPEAT_MS = 500
local MOST_SENDS = 4
local TOO_OLD_MS = 2000
local MOST_WAITING = 10

local HEARTBEAT, COMMAND_LONG, COMMAND_ACK = 0, 76, 77
local USER_1 = 31010
local AUTOPILOT = 1 -- the component id from which ArduPilot sends
local ERROR, WARNING, INFO = 3, 4, 6

assert(param:add_table(TABLE_KEY, "VINE_", 2), "Vine: cannot add parameters")
assert(param:add_param(TABLE_KEY, 1, "COMP", 191), "Vine: cannot add VINE_COMP")
assert(param:add_param(TABLE_KEY, 2, "CHAN", -1), "Vine: cannot add VINE_CHAN")
local component = Parameter("VINE_COMP")
local channel = Parameter("VINE_CHAN")

-- Both arguments are equal, because their order has changed between releases.
mavlink:init(10, 10)
mavlink:register_rx_msgid(HEARTBEAT)
mavlink:register_rx_msgid(COMMAND_ACK)

local companion_channel = nil -- the channel of the companion
local waiting = {} -- items, oldest first; only the first one is being sent
local count = 0

local function own_system()
  return math.floor(param:get("MAV_SYSID") or param:get("SYSID_THISMAV") or 1)
end

-- True for the answer to our command. The companion also answers ground stations that send USER_1.
local function answers_us(message)
  local command, system, to = string.unpack("<I2xxxxxxBB", message, 13)
  return command == USER_1 and system == own_system() and to == AUTOPILOT
end

-- Handles the companion's messages: its channel, and its acknowledgement of an item.
local function listen()
  for _ = 1, 10 do
    local message, chan = mavlink:receive_chan()
    if not message then
      return
    end
    -- mavlink_message_t: system, component and id stand before the payload, which begins at byte 13.
    local system, from = string.unpack("<BB", message, 8)
    local id = string.unpack("<I3", message, 10)
    if system == own_system() and from == math.floor(component:get()) then
      if id == HEARTBEAT then
        companion_channel = chan
      -- A repeat has an answer of its own, which may come when the next item is first but not yet sent.
      elseif id == COMMAND_ACK and waiting[1] and waiting[1].sends > 0 and answers_us(message) then
        table.remove(waiting, 1)
      end
    end
  end
end

local function collect()
  for _ = 1, MOST_WAITING do
    local started_ms, p1, p2, p3, p4 = mission_receive()
    if not started_ms then
      return
    end
    if #waiting < MOST_WAITING then
      -- The count makes two items with the same numbers different commands.
      count = count % 65535 + 1
      waiting[#waiting + 1] = { started_ms = started_ms, numbers = { p1, p2, p3, p4, count }, sends = 0 }
    end
  end
end

local function send(item)
  local chan = channel:get() >= 0 and math.floor(channel:get()) or companion_channel
  if not chan then
    return -- channel unknown; sending on a channel that does not exist can crash older releases
  end
  local n = item.numbers
  local payload = string.pack("<fffffffI2BBB", n[1], n[2], n[3], n[4], n[5], 0, 0,
    USER_1, own_system(), math.floor(component:get()), item.sends)
  if mavlink:send_chan(chan, COMMAND_LONG, payload) then -- false: transmit buffer full
    item.sends = item.sends + 1
    item.sent_ms = millis()
  end
end

local function deliver()
  local item = waiting[1]
  while item and (millis() - item.started_ms):toint() > TOO_OLD_MS do
    gcs:send_text(WARNING, string.format("Vine: component %d does not answer", math.floor(component:get())))
    table.remove(waiting, 1)
    item = waiting[1]
  end
  if not item or item.sends >= MOST_SENDS then
    return
  end
  if item.sends == 0 or (millis() - item.sent_ms):toint() >= REPEAT_MS then
    send(item)
  end
end

local function update()
  listen()
  collect()
  deliver()
end

-- Reports an error and continues.
local function protected_update()
  local good, problem = pcall(update)
  if not good then
    gcs:send_text(ERROR, "Vine: " .. tostring(problem))
    return protected_update, RETRY_AFTER_ERROR_MS
  end
  return protected_update, UPDATE_MS
end

gcs:send_text(INFO, "Vine: script runs")
return protected_update()
