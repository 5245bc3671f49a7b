-- WirePlumber 0.4: hides from PipeWire's programs what gimbald's own camera replaces. Copy to ~/.config/wireplumber/main.lua.d/ (or
-- /etc/wireplumber/main.lua.d/ for all users), uncomment the rules you want, then: systemctl --user restart wireplumber

-- The loopback's twin: without this rule programs list gimbald twice.
table.insert(v4l2_monitor.rules, {
  matches = { { { "api.v4l2.cap.driver", "equals", "v4l2 loopback" } } },
  apply_properties = { ["device.disabled"] = true, ["node.disabled"] = true },
})

-- The real camera, which programs could otherwise take away from gimbald. `wpctl status` and `wpctl inspect ID` tell its device.name.
--table.insert(v4l2_monitor.rules, {
--  matches = { { { "device.name", "equals", "v4l2_device.pci-0000_00_14.0-usb-0_1_1.0" } } },
--  apply_properties = { ["device.disabled"] = true, ["node.disabled"] = true },
--})
