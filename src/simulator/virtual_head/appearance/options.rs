//! Options of a person's appearance: hair, beard, clothes, things.

use super::material::Material;
#[cfg(feature = "studio")]
use super::material::share;
#[cfg(feature = "studio")]
use crate::virtual_head::random::hash;

/// Hair styles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HairStyle {
    /// None.
    Bald,
    /// Millimetres long.
    Cropped,
    /// Centimetres long, combed.
    #[default]
    Short,
    /// Three to five centimetres thick all round.
    Bushy,
    /// Hangs over the ears onto the shoulders.
    Long,
    /// Short, with a fringe over the brow.
    Fringe,
    /// Long, with a fringe over the brow.
    LongFringe,
    /// Hangs in curls.
    Curly,
    /// Tied up.
    Bun,
}

/// Hair on the face.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Beard {
    /// None.
    #[default]
    None,
    /// Colour only.
    Stubble,
    /// Thick, on cheeks and chin.
    Full,
}

/// Headgear.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Headgear {
    /// Nothing.
    #[default]
    None,
    /// Cap with a peak.
    Cap,
    /// Hood of a sweater.
    Hood,
    /// Headphones with a band over the crown.
    Headphones,
}

/// Garment around the neck.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Neck {
    /// Nothing.
    #[default]
    None,
    /// Scarf up to the chin.
    Scarf,
    /// Collar turned up.
    Collar,
}

/// Target or object of the hand that appears now and then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Held {
    /// No hand appears.
    #[default]
    None,
    /// Rests at the chin.
    Chin,
    /// Holds a sheet of paper beside or below the face.
    Paper,
    /// Brings a cup to the mouth.
    Cup,
    /// Holds a phone to the ear.
    Phone,
    /// Covers the mouth.
    Mouth,
}

/// A person's appearance, except the head itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Appearance {
    /// Seed of random details.
    pub seed: u64,
    /// Hair.
    pub hair: HairStyle,
    /// Colour of hair and beard, RGB 0…255.
    pub hair_colour: [f32; 3],
    /// Beard.
    pub beard: Beard,
    /// Thickness of the rims of glasses, metres; 0 = no glasses.
    pub rims_m: f32,
    /// Headgear.
    pub headgear: Headgear,
    /// Garment around the neck.
    pub neck: Neck,
    /// Hand and its object.
    pub held: Held,
    /// Whether a chair's headrest is behind the head.
    pub chair: bool,
    /// Whether somebody stands behind.
    pub bystander: bool,
    /// Colour of the clothes, RGB 0…255.
    pub clothes: [f32; 3],
}

/// Colours of hair: black, dark brown, brown, blond, red, grey.
pub(super) const HAIR_COLOURS: [[f32; 3]; 6] = [
    [30.0, 27.0, 28.0],
    [55.0, 40.0, 32.0],
    [95.0, 68.0, 48.0],
    [176.0, 142.0, 96.0],
    [140.0, 74.0, 42.0],
    [150.0, 148.0, 146.0],
];

impl Appearance {
    /// Appearance of the person in [`crate::virtual_head::Scene::Demo`].
    pub fn demonstration() -> Self {
        Self {
            seed: 4,
            hair: HairStyle::Short,
            hair_colour: HAIR_COLOURS[1],
            clothes: [62.0, 84.0, 118.0],
            ..Self::default()
        }
    }

    /// One of many appearances: hair styles in turn and, with other periods, all things. The same `number` and `seed` give the same
    /// appearance.
    #[cfg(feature = "studio")]
    pub fn numbered(number: usize, seed: u64) -> Self {
        let seed = hash(seed, number as u64);
        let pick = |k: u64, count: usize| (share(seed, k) * count as f32) as usize % count;
        use HairStyle::*;
        let hair = [
            Short, Long, Bushy, Fringe, LongFringe, Cropped, Curly, Bun, Bald,
        ][number % 9];
        Self {
            seed,
            hair,
            hair_colour: HAIR_COLOURS[pick(1, HAIR_COLOURS.len())],
            beard: match number % 5 {
                0 => Beard::Stubble,
                3 => Beard::Full,
                _ => Beard::None,
            },
            rims_m: [0.0, 0.0012, 0.0, 0.0026][number % 4],
            headgear: match number % 11 {
                3 | 7 => Headgear::Headphones,
                5 | 10 => Headgear::Cap,
                8 => Headgear::Hood,
                _ => Headgear::None,
            },
            neck: match number % 7 {
                1 => Neck::Scarf,
                4 => Neck::Collar,
                _ => Neck::None,
            },
            held: match number % 10 {
                0 => Held::Paper,
                2 => Held::Cup,
                6 => Held::Chin,
                9 => Held::Phone,
                _ => Held::None,
            },
            chair: number % 3 == 2,
            bystander: number % 6 == 4,
            clothes: [2, 3, 4].map(|k| {
                let bright = 30.0 + 150.0 * share(seed, 10);
                bright * (0.7 + 0.6 * share(seed, k + 10))
            }),
        }
    }

    /// Material of the clothes, by their brightness.
    pub(super) fn clothes_material(&self) -> Material {
        match self.clothes.iter().sum::<f32>() < 150.0 {
            true => Material::Dark,
            false => Material::Cloth,
        }
    }

    /// Material of the hair, by its brightness.
    pub(super) fn hair_material(&self) -> Material {
        match self.hair_colour.iter().sum::<f32>() < 140.0 {
            true => Material::DarkHair,
            false => Material::Hair,
        }
    }
}

/// Descriptions in the order of [`Held`].
#[cfg(feature = "studio")]
const HELD: [&str; 6] = [
    "",
    "hand at the chin",
    "sheet of paper",
    "cup",
    "phone",
    "hand over the mouth",
];

#[cfg(feature = "studio")]
impl std::fmt::Display for Appearance {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let shade = match self.hair_material() {
            Material::DarkHair if self.hair != HairStyle::Bald => "dark ",
            _ => "",
        };
        let hair = match self.hair {
            HairStyle::Bald => "bald",
            HairStyle::Cropped => "cropped hair",
            HairStyle::Short => "short hair",
            HairStyle::Bushy => "bushy hair",
            HairStyle::Long => "long hair",
            HairStyle::Fringe => "fringe",
            HairStyle::LongFringe => "long hair and fringe",
            HairStyle::Curly => "curly hair",
            HairStyle::Bun => "bun",
        };
        write!(f, "{shade}{hair}")?;
        let if_so = |so: bool, thing| if so { thing } else { "" };
        for thing in [
            ["", "stubble", "full beard"][self.beard as usize],
            if_so(self.rims_m > 0.0, "glasses"),
            ["", "cap", "hood", "headphones"][self.headgear as usize],
            ["", "scarf", "collar"][self.neck as usize],
            HELD[self.held as usize],
            if_so(self.chair, "chair"),
            if_so(self.bystander, "somebody behind"),
        ] {
            if !thing.is_empty() {
                write!(f, ", {thing}")?;
            }
        }
        Ok(())
    }
}
