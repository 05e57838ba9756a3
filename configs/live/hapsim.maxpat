{
 "patcher": {
  "fileversion": 1,
  "appversion": {
   "major": 8,
   "minor": 0,
   "revision": 0,
   "architecture": "x64",
   "modernui": 1
  },
  "classnamespace": "box",
  "rect": [100, 100, 760, 380],
  "boxes": [
   {
    "box": {
     "id": "how",
     "maxclass": "comment",
     "numinlets": 1,
     "numoutlets": 0,
     "patching_rect": [20, 12, 460, 22.0],
     "text": "hapsim from Max, by OSC. Start a scene first: hapsim run first_touch --osc"
    }
   },
   {
    "box": {
     "id": "load",
     "maxclass": "newobj",
     "numinlets": 1,
     "numoutlets": 1,
     "patching_rect": [20, 45, 60, 22.0],
     "outlettype": [""],
     "text": "loadbang"
    }
   },
   {
    "box": {
     "id": "wait",
     "maxclass": "newobj",
     "numinlets": 2,
     "numoutlets": 1,
     "patching_rect": [20, 75, 70, 22.0],
     "outlettype": [""],
     "text": "delay 200"
    }
   },
   {
    "box": {
     "id": "sub",
     "maxclass": "message",
     "numinlets": 2,
     "numoutlets": 1,
     "patching_rect": [20, 105, 170, 22.0],
     "outlettype": [""],
     "text": "/hapsim/subscribe 7479 50"
    }
   },
   {
    "box": {
     "id": "stiffness",
     "maxclass": "flonum",
     "numinlets": 1,
     "numoutlets": 1,
     "patching_rect": [220, 75, 70, 22.0],
     "outlettype": [""]
    }
   },
   {
    "box": {
     "id": "tostiffness",
     "maxclass": "message",
     "numinlets": 2,
     "numoutlets": 1,
     "patching_rect": [220, 105, 180, 22.0],
     "outlettype": [""],
     "text": "/hapsim/touch/stiffness $1"
    }
   },
   {
    "box": {
     "id": "damping",
     "maxclass": "flonum",
     "numinlets": 1,
     "numoutlets": 1,
     "patching_rect": [420, 75, 70, 22.0],
     "outlettype": [""]
    }
   },
   {
    "box": {
     "id": "todamping",
     "maxclass": "message",
     "numinlets": 2,
     "numoutlets": 1,
     "patching_rect": [420, 105, 170, 22.0],
     "outlettype": [""],
     "text": "/hapsim/touch/damping $1"
    }
   },
   {
    "box": {
     "id": "stop",
     "maxclass": "message",
     "numinlets": 2,
     "numoutlets": 1,
     "patching_rect": [620, 105, 90, 22.0],
     "outlettype": [""],
     "text": "/hapsim/stop"
    }
   },
   {
    "box": {
     "id": "send",
     "maxclass": "newobj",
     "numinlets": 1,
     "numoutlets": 0,
     "patching_rect": [20, 160, 160, 22.0],
     "text": "udpsend 127.0.0.1 7471"
    }
   },
   {
    "box": {
     "id": "receive",
     "maxclass": "newobj",
     "numinlets": 1,
     "numoutlets": 1,
     "patching_rect": [20, 220, 120, 22.0],
     "outlettype": [""],
     "text": "udpreceive 7479"
    }
   },
   {
    "box": {
     "id": "route",
     "maxclass": "newobj",
     "numinlets": 5,
     "numoutlets": 5,
     "patching_rect": [20, 250, 430, 22.0],
     "outlettype": ["", "", "", "", ""],
     "text": "route /hapsim/position /hapsim/velocity /hapsim/force /hapsim/error"
    }
   },
   {
    "box": {
     "id": "position",
     "maxclass": "flonum",
     "numinlets": 1,
     "numoutlets": 1,
     "patching_rect": [20, 290, 90, 22.0],
     "outlettype": [""]
    }
   },
   {
    "box": {
     "id": "velocity",
     "maxclass": "flonum",
     "numinlets": 1,
     "numoutlets": 1,
     "patching_rect": [130, 290, 90, 22.0],
     "outlettype": [""]
    }
   },
   {
    "box": {
     "id": "force",
     "maxclass": "flonum",
     "numinlets": 1,
     "numoutlets": 1,
     "patching_rect": [240, 290, 90, 22.0],
     "outlettype": [""]
    }
   },
   {
    "box": {
     "id": "error",
     "maxclass": "newobj",
     "numinlets": 1,
     "numoutlets": 0,
     "patching_rect": [350, 290, 90, 22.0],
     "text": "print hapsim"
    }
   },
   {
    "box": {
     "id": "units",
     "maxclass": "comment",
     "numinlets": 1,
     "numoutlets": 0,
     "patching_rect": [20, 315, 330, 22.0],
     "text": "m              m/s               N"
    }
   }
  ],
  "lines": [
   {
    "patchline": {
     "source": ["route", 0],
     "destination": ["position", 0]
    }
   },
   {
    "patchline": {
     "source": ["route", 1],
     "destination": ["velocity", 0]
    }
   },
   {
    "patchline": {
     "source": ["route", 2],
     "destination": ["force", 0]
    }
   },
   {
    "patchline": {
     "source": ["route", 3],
     "destination": ["error", 0]
    }
   },
   {
    "patchline": {
     "source": ["load", 0],
     "destination": ["wait", 0]
    }
   },
   {
    "patchline": {
     "source": ["wait", 0],
     "destination": ["sub", 0]
    }
   },
   {
    "patchline": {
     "source": ["sub", 0],
     "destination": ["send", 0]
    }
   },
   {
    "patchline": {
     "source": ["stiffness", 0],
     "destination": ["tostiffness", 0]
    }
   },
   {
    "patchline": {
     "source": ["tostiffness", 0],
     "destination": ["send", 0]
    }
   },
   {
    "patchline": {
     "source": ["damping", 0],
     "destination": ["todamping", 0]
    }
   },
   {
    "patchline": {
     "source": ["todamping", 0],
     "destination": ["send", 0]
    }
   },
   {
    "patchline": {
     "source": ["stop", 0],
     "destination": ["send", 0]
    }
   },
   {
    "patchline": {
     "source": ["receive", 0],
     "destination": ["route", 0]
    }
   }
  ]
 }
}
