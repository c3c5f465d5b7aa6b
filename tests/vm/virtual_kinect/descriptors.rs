//! What enumeration shows of the virtual Kinect's functions.

use mien_sensors::kinect::device::Model;

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Function {
    Camera,
    Motor,
    Audio,
}

/// What enumeration shows of a function.
pub(crate) struct Descriptors {
    pub(crate) function: Function,
    pub(crate) model: Model,
    pub(crate) serial: String,
    /// A camera as it should be, with a setting that has the isochronous endpoints.
    pub(crate) streams: bool,
}

impl Descriptors {
    pub(crate) fn product(&self) -> (u16, u16) {
        match (self.function, self.model) {
            (Function::Camera, Model::Xbox1414) => (0x02ae, Model::FIRST_SERIES_RELEASE),
            (Function::Camera, Model::Xbox1473) => (0x02ae, 0x0114),
            (Function::Camera, Model::Windows1517) => (0x02bf, 0x0205),
            (Function::Motor, _) => (0x02b0, 0x0105),
            (Function::Audio, Model::Windows1517) => (0x02be, 0x0100),
            (Function::Audio, _) => (0x02ad, 0x0100),
        }
    }

    pub(crate) fn device(&self) -> Vec<u8> {
        let (product, release) = self.product();
        let class = if self.function == Function::Audio {
            255
        } else {
            0
        };
        let mut bytes = vec![18, 1, 0x00, 0x02, class, 0, 0, 64];
        bytes.extend(Model::VENDOR.to_le_bytes());
        bytes.extend(product.to_le_bytes());
        bytes.extend(release.to_le_bytes());
        bytes.extend([1, 2, 3, 1]);
        bytes
    }

    /// Endpoints of an alternate setting: address, attributes, packet size.
    pub(crate) fn endpoints(&self, alternate: u8) -> Vec<(u8, u8, u16)> {
        match self.function {
            Function::Camera if self.streams && alternate == self.model.alternate_setting() => {
                vec![(0x81, 1, 0x0bc0), (0x82, 1, 0x0bc0)]
            }
            Function::Audio => vec![(0x81, 2, 512), (0x01, 2, 512)],
            _ => vec![],
        }
    }

    pub(crate) fn configuration(&self) -> Vec<u8> {
        let last = match self.function {
            Function::Camera if self.streams => self.model.alternate_setting(),
            _ => 0,
        };
        let mut body = Vec::new();
        for alternate in 0..=last {
            let endpoints = self.endpoints(alternate);
            body.extend([9, 4, 0, alternate, endpoints.len() as u8, 255, 255, 255, 0]);
            for (address, attributes, size) in endpoints {
                let [low, high] = size.to_le_bytes();
                body.extend([7, 5, address, attributes, low, high, 1]);
            }
        }
        let [low, high] = (9 + body.len() as u16).to_le_bytes();
        let mut bytes = vec![9, 2, low, high, 1, 1, 0, 0xc0, 8];
        bytes.extend(body);
        bytes
    }

    pub(crate) fn string(&self, index: u8) -> Option<Vec<u8>> {
        let text = match (index, self.function) {
            (0, _) => return Some(vec![4, 3, 9, 4]),
            (1, _) => "Microsoft",
            (2, Function::Camera) => "Xbox NUI Camera",
            (2, Function::Motor) => "Xbox NUI Motor",
            (2, Function::Audio) => "Xbox NUI Audio",
            // The later models' cameras hide their serial.
            (3, Function::Camera) if self.model != Model::Xbox1414 => "0000000000000000",
            (3, _) => &self.serial,
            _ => return None,
        };
        let mut bytes = vec![2 + 2 * text.len() as u8, 3];
        bytes.extend(text.encode_utf16().flat_map(u16::to_le_bytes));
        Some(bytes)
    }

    /// Answer to a standard request that reads.
    pub(crate) fn answer(&self, request: u8, value: u16) -> Option<Vec<u8>> {
        match (request, value >> 8) {
            (6, 1) => Some(self.device()),
            (6, 2) => Some(self.configuration()),
            (6, 3) => self.string(value as u8),
            (6, 6) => Some(vec![10, 6, 0, 2, 0, 0, 0, 64, 1, 0]),
            (0, _) => Some(vec![1, 0]),
            _ => None,
        }
    }
}
