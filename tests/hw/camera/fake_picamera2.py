"""The library picamera2 with one camera behind it, as far as hw/camera/libcamera.py sees it, in virtual time.

A control takes effect with the request that is queued next, as many frames later as there are buffers. A frame tells
where the lens was told to be when the frame was processed; it shows where the lens was when it was exposed.
"""

from tests.hw.camera.fake_v4l2 import CALL_NS, Clock, scene

PERIOD_NS = 33_333_000
PROCESSING_NS = 10_000_000  # from the end of the readout to a completed request
SLEW = 0.12  # dioptres that the lens goes in a frame, at most
MEASURED = {"ExposureTime": 8000, "AnalogueGain": 2.0, "ColourGains": (1.7, 1.4)}


class Request:
    def __init__(self, camera, about, lens):
        self.camera, self.about, self.lens = camera, about, lens

    def get_metadata(self):
        return self.about

    def make_array(self, name):
        assert name == "main"
        return scene(round(100 * self.lens))

    def release(self):
        self.camera.held -= 1


class FakePicamera2:
    def __init__(self, computer):
        if computer.in_use:
            raise RuntimeError("Camera __init__ sequence did not complete.")
        self.computer, self.clock = computer, computer.clock
        self.camera_controls = computer.controls
        self.queued = []  # (number of the frame, controls)
        self.set = {"AeEnable": True, "AwbEnable": True, "LensPosition": 0.0}
        self.frames, self.held = 0, 0
        self.lens = [(0, 0.0)]  # since when, dioptres
        self.running = False
        computer.camera = self

    def create_video_configuration(self, main, buffer_count):
        assert main["format"] == "RGB888"
        return {"main": main, "buffer_count": buffer_count}

    def configure(self, configuration):
        self.configuration = configuration

    def camera_configuration(self):
        return self.configuration

    def set_controls(self, controls):
        for name in controls:
            if name not in self.camera_controls:
                raise RuntimeError(f"Control {name} is not advertised by libcamera")
        self.clock.now_ns += CALL_NS
        self.queued.append((self.frames + self.configuration["buffer_count"], dict(controls)))

    def start(self):
        self.running, self.began_ns = True, self.clock.now_ns

    def capture_request(self, wait):
        assert wait is False and self.running
        return object()

    def wait(self, job, timeout):
        until_ns = self.clock.now_ns + round(timeout * 1e9)
        while not self.computer.gone:
            done_ns = self.began_ns + PERIOD_NS + PROCESSING_NS
            if done_ns > until_ns:
                break
            frame = self.process()
            if done_ns > self.clock.now_ns:
                self.clock.now_ns = done_ns
                self.held += 1
                assert self.held == 1, "a request that is not given back is one less to fill"
                return frame
        self.clock.now_ns = until_ns
        raise TimeoutError

    def process(self):
        """The frame that is exposed next: readout begins when the exposure of its first row is over."""
        began_ns, self.began_ns = self.began_ns, self.began_ns + PERIOD_NS
        self.frames += 1
        for frame, controls in self.queued:
            if frame <= self.frames:
                self.set.update(controls)
        self.queued = [one for one in self.queued if one[0] > self.frames]
        known = self.lens[-1][1]
        told = known + min(max(self.set["LensPosition"] - known, -SLEW), SLEW)
        shown = next(lens for t_ns, lens in reversed(self.lens) if t_ns <= began_ns)
        self.lens.append((began_ns + PERIOD_NS, told))
        automatic = {name: MEASURED[name] for name in ("ExposureTime", "AnalogueGain")} if self.set["AeEnable"] else {}
        about = {**MEASURED, **self.set, **automatic}
        if self.computer.keeps_us and not self.set["AeEnable"]:
            about["ExposureTime"] = self.computer.keeps_us
        about["SensorTimestamp"] = began_ns + about["ExposureTime"] * 1000
        if "LensPosition" in self.camera_controls and self.computer.tuned:
            about["LensPosition"] = told
        else:
            del about["LensPosition"]
        return Request(self, about, shown)

    def close(self):
        self.running = False


class FakePi:
    """A computer with one CSI camera; itself in place of the class Picamera2."""

    def __init__(self):
        self.clock = Clock()
        self.gone = self.in_use = False
        self.tuned = True  # its tuning file knows the lens
        self.keeps_us = 0  # the exposure that it has, whatever is asked for
        self.camera = None
        span = (0, 0, 0)
        names = ("AeEnable", "AwbEnable", "ExposureTime", "AnalogueGain", "ColourGains", "AfMode", "Sharpness")
        self.controls = dict.fromkeys((*names, "FrameDurationLimits", "AeFlickerMode", "AeFlickerPeriod"), span)
        self.controls["LensPosition"] = (0.0, 0.3, 0.1)

    def __call__(self, number):
        assert number == 0
        return FakePicamera2(self)

    def global_camera_info(self):
        return [] if self.gone else [{"Model": "imx708", "Id": "/base/axi/pcie/rp1/i2c/imx708@1a", "Num": 0}]
